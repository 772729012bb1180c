# Two commands: `make demo` and `make test`. Each makes its own environment in .venv first,
# from the exact files whose hashes are in requirements.lock; nothing else is needed but Python 3.11+ and make.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
THEIRS := $(VENV)/.counterparts
OUT    ?= demo-out
# What is not what a lock file has the hash of is refused. No build has an environment of its own, which no lock knows.
LOCKED := $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-build-isolation -r
# Tests start a hundred commands, which find their modules compiled even where the environment says otherwise.
KEEP   := PYTHONDONTWRITEBYTECODE=
# Makes lock files and the bill of materials; apart, so that neither lists its own tools.
TOOLS  := build/tools

.PHONY: install demo drives test fast kernel ruff types style test-slow slow slow-kernel test-study lint test-kernel \
	soak live-soak fixtures faults nth-fault clock-faults attacks kills mutate coverage runs untuned table5 replication imu-links walker bench \
	evidence port port-faults fuzz tutorial screenshots changed servos servo-laws payloads uses looks lab-chain timing tuning engines \
	trust wheel arm64 \
	lock sbom docs clean

$(STAMP): requirements.lock requirements-build.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(LOCKED) requirements-build.lock
	$(LOCKED) requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@echo "compiling kernels, which Numba's cache keeps"
	$(BIN)/python -c "from estimator.likelihood import compile_kernels; compile_kernels()"
	touch $@

install: $(STAMP)

demo: $(STAMP)
	$(BIN)/legid demo --out $(OUT)

lint: ruff types style

ruff: $(STAMP)
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/mypy

# Size of the code, layout, words of code and pages.
style: $(STAMP)
	$(BIN)/python -m tests.style

# Other people's drivers, held against ours. Where one of them does not install, its tests are skipped.
$(THEIRS): $(STAMP) requirements-counterparts.lock
	$(LOCKED) requirements-counterparts.lock || echo "without other people's drivers: their tests are skipped"
	touch $@

# Style, types and tests side by side. The tests themselves: `make fast`.
test: $(STAMP) $(THEIRS)
	$(MAKE) --jobs 2 fast kernel lint

# The numerics with another BLAS kernel: no test hangs on how a sum is rounded.
kernel: $(STAMP)
	$(KEEP) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.tools.other_kernel

fast: $(STAMP) $(THEIRS)
	$(KEEP) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow and not study" tests

# The demo, the tutorial, the example and the site, from their first command to their last page; public records, kills
# of studies and recordings, clusters, the generator of `make evidence`, and the drivers on a real kernel.
test-slow: $(STAMP) $(THEIRS)
	$(MAKE) --jobs 2 slow slow-kernel

slow: $(STAMP) $(THEIRS)
	$(KEEP) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder \
		-m "slow and not study" tests

slow-kernel: $(STAMP)
	$(KEEP) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.tools.other_kernel --slow

# The same on other drives and seeds, and on all public records of the casebook: half an hour.
test-study: $(STAMP) $(THEIRS)
	$(KEEP) OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -m study tests

test-kernel: $(STAMP)
	$(BIN)/python -m tests.kernel

bench: $(STAMP)
	$(LOCKED) requirements-bench.lock
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence bench.speed --out docs/evidence/bench.md

# What `legid diagnose` names, every family of cases from fresh seeds: an hour. FAMILIES="servo geared" takes these alone.
# FAMILIES=records alone: docs/evidence/real-records.md.
# EFFECTS=none,drag or SEEDS=401,405: only cases with such names, of these seeds; the page is then build/evidence/causes.md.
# RUNS_AT_ONCE=1: each diagnosis on all cores, for times.
# MINUTES=0 ANSWERS=FOLDER: the page anew from the answers of an earlier call.
evidence: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence blind.causes \
		--minutes $(or $(MINUTES),60) --seed $(or $(SEED),2000) --at-once $(or $(RUNS_AT_ONCE),2) \
		$(if $(FAMILIES),--families $(FAMILIES)) $(if $(EFFECTS),--effects $(EFFECTS)) $(if $(SEEDS),--seeds $(SEEDS)) \
		$(if $(ANSWERS),--answers $(ANSWERS)) --out $(if $(EFFECTS)$(SEEDS),build/evidence,docs/evidence)/$(if $(filter-out records,$(or $(FAMILIES),all)),causes,real-records).md

soak: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence soak --out docs/evidence/soak.md

# tests/fixtures/*.mcap anew, from one seed: after a change of the run format.
fixtures: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.tools.fixtures

# Every fault at every moment on virtual time, ten minutes: how long the torque outlives it.
drives: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence drives --out docs/evidence/drives.md

faults: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence faults --out docs/evidence/faults.md

# The Nth write, flush, sync, read and allocation of a recording fails, for every N, on four drives. EVERY=50: of reads and
# allocations every 50th, ten minutes.
EVERY ?= 1
nth-fault: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence nth-fault --every $(EVERY) --out docs/evidence/nth-fault.md

# The controller's clock steps, wraps, freezes or runs at another rate while a leg is recorded: ten minutes.
clock-faults: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence clock-faults --out docs/evidence/clock-faults.md

# Forty files made to hang, to fill the memory, to crash a reader or to lead elsewhere, through the commands.
attacks: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence attacks --out docs/evidence/attacks.md

# An hour and a half of real time: recordings killed at any moment, and others with a second process at their devices and file.
# A fifth have ended before their kill.
KILLS ?= 1280
kills: $(STAMP)
	$(BIN)/python -m evidence kills --kills $(KILLS) --out docs/evidence/kills.md

# Files broken in bytes and in structure through every reader, the same time for each format; MINUTES=20 ends it.
FILES ?= 100000
mutate: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence mutate --files $(FILES) $(if $(MINUTES),--minutes $(MINUTES))

# 200 fits a row take hours; FITS=10 RATES=100 a few minutes.
FITS  ?= 200
PLANT ?= stickslip
RATES ?= 50 100 250 500
coverage: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence coverage --plant $(PLANT) --fits $(FITS) --rates $(RATES) \
		$(if $(SEED),--seed $(SEED)) --out docs/evidence/coverage-$(PLANT).md

# A quarter of an hour: Table V of the paper for every method on twenty legs.
table5: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence table5 --out docs/evidence/table5.md

# Table III under the protocol that the paper is nearest to, and what each open choice does to it.
RUNS ?= 200
replication: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence replication --runs $(RUNS) --out docs/evidence/replication.md

# Twenty steps of a walker: touchdowns, fits, free runs over steps, diagnoses. Half an hour.
WALKS ?= 24
walker: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence walker --fits $(WALKS) --out docs/evidence/walker.md

# IMUs on any links and a subset of encoders: legs, a walker, chains of three and seven links; do their intervals hold?
imu-links: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence imu-links --fits $(FITS) --out docs/evidence/imu-links.md

# Legs that follow a command, and the records of a real servo: a quarter of an hour. Called again it goes on; MINUTES=, SEED=.
# ONLY=hidden RECORDS=0 MINUTES=60: hidden causes alone, to build/evidence. A diagnosis ends after five minutes of processor time.
servos: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence servos --minutes $(or $(MINUTES),9) --records $(or $(RECORDS),6) \
		--seed $(or $(SEED),7000) --only "$(ONLY)" --out $(if $(ONLY),build,docs)/evidence/servos.md

# Friction laws of a servo fitted to the same runs, on records next to the checkout: four minutes.
servo-laws: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence servo-laws --out docs/evidence/servo-laws.md

# Runs that differ: coverage and width of intervals that allow for it; FITS=24 takes a quarter of an hour.
runs: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence runs --fits $(FITS) --out docs/evidence/runs.md

# Faults in the later runs of real records next to the checkout; the earlier runs are the reference. Half an hour.
changed: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence what-changed --minutes $(or $(MINUTES),60) --out docs/evidence/what-changed.md

# Legs whose controller, log and drive keep times of their own: an hour.
timing: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence timing --minutes $(or $(MINUTES),60) --seed $(or $(SEED),6000) --out docs/evidence/timing.md

# Rate, hold and delay that `legid tune` finds for such legs: twenty minutes.
tuning: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence tuning --minutes $(or $(MINUTES),20) --seed $(or $(SEED),6100) --out docs/evidence/tuning.md

# Healthy legs in Pinocchio and PyBullet (the extra "engines"), and under rates that are not theirs: an hour.
engines: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence engines --minutes $(or $(MINUTES),60) --seed $(or $(SEED),6200) --out docs/evidence/engines.md


# Exported models in MuJoCo against `legid simulate`, on records next to the checkout against legid's own, and their speed.
simulators: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence simulators --legs $(or $(SIMULATED),3) --out docs/evidence/simulators.md

# A lab's signal chain, all small faults of its sensors at once: twenty minutes.
lab-chain: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence lab-chain --minutes $(or $(MINUTES),20) --seed $(or $(SEED),6500) --out docs/evidence/lab-chain.md

# Fits of legs with known parameters, then of real records next to the checkout: an hour. SNAPSHOTS: see `machines`.
trust: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence trust --minutes $(or $(MINUTES),60) \
		$(if $(SNAPSHOTS),--snapshots $(SNAPSHOTS)) --out docs/evidence/trust-rates.md

# Emulated legs with a mass added to link 2 at a random place: twenty minutes.
payloads: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence payloads --minutes $(or $(MINUTES),30) --out docs/evidence/payloads.md

# Uses that fits and diagnoses state, on runs that neither has seen: three quarters of an hour.
uses: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence uses --minutes $(or $(MINUTES),45) --out docs/evidence/uses.md

# Looks at healthy readings, readings with faults put in, and fits of legs whose torque is clipped: ten minutes.
looks: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence looks --out docs/evidence/looks.md

# Real records next to the checkout, with minimal rig files, and records with an error put in: a quarter of an hour.
untuned: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence untuned --out docs/evidence/untuned.md

# Half an hour; needs chromium and its chromedriver.
live-soak: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence live-soak --out docs/evidence/live.md

# The example board, cross-compiled and driven in an emulator.
port: $(STAMP)
	@{ command -v arm-none-eabi-gcc && command -v qemu-system-arm; } >/dev/null || \
		{ echo "make port needs the Debian packages gcc-arm-none-eabi and qemu-system-arm: apt-get install both"; exit 1; }
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -v tests/drivers/test_port.py

# Every fault of the example board's line, its program and the board itself at every moment, in real time: a quarter of
# an hour. Needs the right to real-time priority.
port-faults: $(STAMP)
	@{ command -v arm-none-eabi-gcc && command -v qemu-system-arm; } >/dev/null || \
		{ echo "make port-faults needs the Debian packages gcc-arm-none-eabi and qemu-system-arm: apt-get install both"; \
		exit 1; }
	OMP_NUM_THREADS=1 $(BIN)/python -m evidence port-faults --out docs/evidence/port-faults.md

# The firmware's core under broken input, with address and undefined behaviour sanitizers. FRAMES are serial and CAN
# together; 10^7 each take a minute.
FRAMES ?= 1000000
fuzz: $(STAMP)
	$(BIN)/python -m evidence fuzz-core --frames $(FRAMES)

# After a change of what commands print: the tutorial's outputs and figures anew.
tutorial: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.tools.tutorial

# Pictures of the pages and the dashboard, and the README's figure. Needs chromium and its chromedriver; five minutes.
screenshots: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.tools.screenshots

# dist/legid-*.whl; test-slow installs one in an environment of its own.
wheel: $(STAMP)
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

# Asks the package index for wheels alone, of everything that runs on a 64-bit Arm board: nothing is installed.
arm64: $(STAMP)
	$(BIN)/python -m tests.tools.arm64

$(TOOLS)/.installed: requirements-release.lock
	$(PYTHON) -m venv --clear $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-release.lock
	touch $@

# After a change of the dependencies in pyproject.toml: all lock files, with the versions that they have where those are
# still allowed; UPGRADE=1 takes the newest. A minute or two of waiting for the index.
lock: $(STAMP) $(TOOLS)/.installed
	$(BIN)/python -m tests.tools.lock --uv $(TOOLS)/bin/uv $(if $(UPGRADE),--upgrade)

# CycloneDX: every package that is installed in .venv, with its version, licence and package URL.
SBOM ?= sbom.cdx.json
sbom: $(STAMP) $(TOOLS)/.installed
	$(TOOLS)/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --output-format JSON \
		--output-file $(SBOM) $(BIN)/python
	@echo "the bill of materials is in $(SBOM)"

docs: $(STAMP)
	$(LOCKED) requirements-docs.lock
	$(BIN)/python -m sphinx -W -q -b html -d build/doctrees docs site
	@echo "open site/index.html in a browser"

clean:
	rm -rf $(VENV) $(OUT) $(SBOM) dist site docs/generated build *.egg-info .pytest_cache .mypy_cache .ruff_cache
