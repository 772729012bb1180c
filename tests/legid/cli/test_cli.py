"""The command line: answers at once, ends with the right status, one line for every fault, files as promised."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
import pytest

from daq import WorkError
from daq.recording import Plan, write_plan
from daq.runs import read_csv, read_run
from drivers import LinkLost
from drivers.mock import MockRig, PtyServer, RealClock
from estimator import FitError
from experiments.emulation.plant import LegPlant
from experiments.excite import random_multisine
from experiments.models import save_model
from legid import cli
from legid.cli.main import GROUPS
from tests.support.extended_models import model_with
from tests.support.paths import DEMO_RIG as RIG
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK, ran
from tests.support.shell import Shell, typed

pytestmark = REAL_CLOCK

COMMANDS = sorted(info.name for info in iter_modules([str(ROOT / "legid/cli/commands")]))
HEAVY = {"numpy", "scipy", "matplotlib", "jinja2", "mcap", "serial", "smbus2", "msgspec"}


@pytest.fixture(scope="module")
def model_file(module_path: Path) -> Path:
    """A model with the plant's true parameters."""
    path = module_path / "model.json"
    save_model(model_with(), path)
    return path


def plan_file(folder: Path, torque_nm: np.ndarray) -> None:
    """A second of these torques."""
    write_plan(Plan(np.arange(100) / 100.0, torque_nm), folder / "plan.csv")


# -- help and arguments ------------------------------------------------------------------------------------


def test_the_order_of_help_names_commands() -> None:
    assert sorted(name for names in GROUPS.values() for name in names) == COMMANDS


def test_help_loads_nothing_heavy() -> None:
    script = ("import sys; from legid.cli import main; status = main(['--help']); "
              f"print(sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr); sys.exit(status)")
    done = ran("-c", script)
    assert done.stderr.strip() == "[]"
    for name in COMMANDS:
        assert name.rstrip("_").replace("_", "-") in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, shell: Shell) -> None:
    shell(name.rstrip("_").replace("_", "-"), "--help")
    assert len(shell.out) > 200


def test_version(shell: Shell) -> None:
    shell("--version")
    assert shell.out.startswith("legid ")


@pytest.mark.parametrize("args", [
    "", "nonsense", "fit", "fit a.csv --rig r --method guess", "fit a.csv --rig r --fix beta1",
    "fit a.csv --rig r --sensors eyes", "info", "export a.csv --to xls --out b", "info a.csv --quiet --verbose",
    "demo --seconds 0", "demo --seed -1", "demo --effect magic", "demo --runs 1", "diagnose",
    "simulate m.json --plan p.csv --out o.csv --start 500,0", "simulate m.json --plan p.csv --out o.csv --rate 0",
    "simulate m.json --plan p.csv --out o.csv --start up", "record --rig r"])
def test_bad_arguments(args: str, shell: Shell) -> None:
    assert "--help" in shell.fails(args)


@pytest.mark.parametrize("args", [
    "info none.mcap", "info none.csv", "recover none.mcap", "export none.csv --to csv --out x",
    "validate none.json none.csv --rig none.toml", "simulate none.json --plan none.csv --out x",
    "fit none.csv --rig none.toml", "record --rig none.toml --plan none.csv --out x.mcap",
    "diagnose none.csv --rig none.toml"])
def test_missing_files_are_named(args: str, shell: Shell, here: Path) -> None:
    assert "none." in shell.fails(args)
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("error", [FitError("cannot\nbe fitted"), WorkError("tripped"), LinkLost("gone"),
                                   KeyboardInterrupt(), ZeroDivisionError("oops")])
def test_every_failure_is_one_line(error: BaseException, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(args: object) -> int:
        raise error

    monkeypatch.setattr("legid.cli.commands.info.run", fail)
    shell.fails("info x", status=1)


def test_an_unexpected_error_can_be_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("legid.cli.commands.info.run", lambda args: 1 // 0)
    monkeypatch.setenv(cli.TRACEBACK, "1")
    with pytest.raises(ZeroDivisionError):
        typed("info x")


def test_a_reader_that_leaves_is_no_fault(demo_run: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "legid.cli", "info", str(demo_run)], stdout=write,
                          stderr=subprocess.PIPE, cwd=ROOT, check=False)
    os.close(write)
    assert done.stderr == b""


# -- looking into runs -------------------------------------------------------------------------------------


def test_info_tells_streams_losses_clocks_and_rig(demo_run: Path, shell: Shell) -> None:
    shell("info", demo_run)
    text = shell.out
    for word in ("/imu", "/leg/telemetry", "telemetry frames lost: 0", "IMU gaps of unknown length: 0", "ppm, within",
                 "leg2", "the file is whole", "start: armed", "stop: plan done", "faults seen: none"):
        assert word in text


def test_info_of_a_csv(here: Path, shell: Shell) -> None:
    rows = "".join(f"{k / 100 + (0.5 if k > 60 else 0)},{k},x\n" for k in range(100))
    (here / "a.csv").write_text("time_s,q2_rad,note\n" + rows)
    shell("info a.csv")
    text = shell.out
    assert "100 samples" in text and "100 Hz" in text and "gaps: 1, longest 0.51 s" in text and "ignored: note" in text


def test_recover_saves_what_a_crash_left(demo_run: Path, here: Path, shell: Shell) -> None:
    cut = here / "cut.mcap"
    data = demo_run.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    shell("info cut.mcap")
    assert "cut off" in shell.out
    shell("recover cut.mcap")
    assert "was cut off" in shell.out
    saved = read_run(here / "cut.recovered.mcap")
    assert saved.complete and 0.4 < saved.messages / read_run(demo_run).messages < 0.8
    assert "exists already" in shell.fails("recover cut.mcap")
    assert cut.read_bytes() == data[: len(data) * 2 // 3]


def test_exports_agree(demo_run: Path, here: Path, shell: Shell) -> None:
    scipy_io, parquet = pytest.importorskip("scipy.io"), pytest.importorskip("pyarrow.parquet")
    for kind in ("csv", "parquet", "mat"):
        shell("export", demo_run, "--to", kind, f"--out r.{kind}")
    table = read_csv(here / "r.csv")
    assert {"q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2", "q1_rad"} <= set(table.columns)
    columns = parquet.read_table(here / "r.parquet").to_pydict()
    matlab = scipy_io.loadmat(here / "r.mat")
    for name in ("q2_rad", "accel_y_mps2"):
        np.testing.assert_allclose(columns[name], table.columns[name], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(matlab[name][:, 0], table.columns[name], rtol=1e-10, atol=1e-12)


def test_export_of_a_csv_at_another_rate(demo_run: Path, here: Path, shell: Shell) -> None:
    shell("export", demo_run, "--to csv --out a.csv")
    shell("export a.csv --to csv --rate 50 --out b.csv")
    half, full = read_csv(here / "b.csv"), read_csv(here / "a.csv")
    assert half.time_s.size == pytest.approx(full.time_s.size / 5, abs=2)


def test_output_that_cannot_be_written(demo_run: Path, here: Path, shell: Shell) -> None:
    for kind in ("csv", "mat", "parquet"):
        assert "no/where" in shell.fails("export", demo_run, "--to", kind, "--out no/where")


# -- simulation --------------------------------------------------------------------------------------------


def test_start_must_fit_the_mechanism(model_file: Path, here: Path, shell: Shell) -> None:
    plan_file(here, np.zeros(100))
    assert "--start" in shell.fails("simulate", model_file, "--plan plan.csv --start 1,2,3 --out r.csv")


# -- recording ---------------------------------------------------------------------------------------------


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A rig file whose port is a real PTY and whose I2C bus is the emulated chip, in real time."""
    mock = MockRig(LegPlant(), RealClock(), seed=3)
    monkeypatch.setattr("experiments.rig.devices.open_bus", lambda path: mock.imu)
    with PtyServer(mock.firmware) as server:
        # A busy test machine is slower than any limit meant for a leg: what is tested here is the command.
        patient = (RIG.read_text().replace("/dev/ttyACM0", server.path)
                   .replace("watchdog_ms = 100", "watchdog_ms = 1000")
                   .replace("[limits]", "[limits]\nstaleness_s = 5.0\nclock_bound_s = 5.0"))
        (tmp_path / "rig.toml").write_text(patient)
        yield tmp_path


def test_record_over_a_serial_port(bench: Path, shell: Shell) -> None:
    plan_file(bench, 0.2 * np.sin(2 * np.pi * np.arange(100) / 100.0))
    args = "record --rig", bench / "rig.toml", "--plan", bench / "plan.csv", "--out", bench / "run.mcap"
    shell(*args)
    assert "torque commands" in shell.out
    raw = read_run(bench / "run.mcap")
    assert raw.complete and raw.files["rig.toml"] == (bench / "rig.toml").read_text()
    assert raw.streams["/leg/telemetry"]["torque_cmd_nm"].max() > 0.15
    assert "exists already" in shell.fails(*args)


def test_record_refuses_a_plan_beyond_the_limits(bench: Path, shell: Shell) -> None:
    plan_file(bench, np.full(100, 9.0))
    line = shell.fails("record --rig", bench / "rig.toml", "--plan", bench / "plan.csv", "--out", bench / "run.mcap")
    assert "9 N m" in line


def test_record_without_devices_says_what_is_missing(here: Path, shell: Shell) -> None:
    plan_file(here, np.zeros(100))
    absent = here / "rig.toml"
    absent.write_text(RIG.read_text().replace("/dev/ttyACM0", "/dev/no-such-port"))
    args = ("--plan plan.csv --out r.mcap",)
    assert "/dev/no-such-port" in shell.fails("record --rig rig.toml", *args, status=1)
    absent.write_text('[mechanism]\nmodel = "leg2"\nactuated = [2]\n')
    assert "devices.controller" in shell.fails("record --rig rig.toml", *args)
    assert not (here / "r.mcap").exists()


def test_record_from_an_emulated_leg_says_so(here: Path, shell: Shell) -> None:
    """Nothing of the rig's devices is opened; what is hidden is not in the file."""
    write_plan(random_multisine(1, 4.0, 0.3), here / "plan.csv")
    start = "record --rig", RIG, "--plan plan.csv --out run.mcap"
    shell(*start, "--emulate quadratic_drag --seed", 3)
    shell("info run.mcap")
    said = shell.out
    assert "recorded from an emulated leg" in said and "drag" not in said
    raw = read_run(here / "run.mcap")
    assert raw.streams["/imu"].size > 1900 and raw.files["rig.toml"] == RIG.read_text()
    assert "exists" in shell.fails(*start, "--emulate")
    assert "invalid choice" in shell.fails(*start, "--emulate ghosts")
