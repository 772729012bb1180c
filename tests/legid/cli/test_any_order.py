"""Import, fit, tune and diagnose in any order, repeated, interrupted, killed: the next command takes what is left."""

import json
import os
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from daq.runs import read_csv
from experiments.exchange import load_map
from experiments.models import load_model
from legid.cli import main
from tests.support.geared_pendulum import GearedPendulum, record

LOGS = [f"log{k}.csv" for k in range(3)]
RUNS = [f"runs/{log}" for log in LOGS]
COMMANDS = {
    "import": ["import", *LOGS, "--out", "runs", "--yes"],
    "fit": ["fit", *RUNS, "--json", "fit.json", "--html", "fit.html", "--model-out", "model.json"],
    "tune": ["tune", *RUNS, "--rig", "rig.toml", "--write", "--json", "tune.json"],
    "diagnose": ["diagnose", *RUNS, "--workers", "1", "--json", "diagnosis.json", "--html", "diagnosis.html",
                 "--model-out", "model.json"],
    "validate": ["validate", "model.json", *RUNS, "--json", "validation.json"],
}
STEPS = ("fsync", "link", "replace")
"""What every file is written with, last of all."""
MOST_STEPS = 12
KILLED = 137


def write_logs(folder: Path) -> None:
    """Three files of another program, degrees at 25 Hz, and a rig file that says little."""
    rng = np.random.default_rng(0)
    for log in LOGS:
        run = record(GearedPendulum(gear_error=0.0, wander=0.0), rng, seconds=4.0)
        table = np.stack([run.time_s, np.degrees(run["q1_rad"]), run["tau1_nm"]], axis=1)[::4]
        np.savetxt(folder / log, table, delimiter=",", header="t,pos [deg],effort", comments="")
    (folder / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n[sampling]\nrate_hz = 25.0\n')


def stop_at(patch: pytest.MonkeyPatch, last: int, late: bool, stop: Callable[[], None]) -> None:
    """From here on `stop` is called at step number `last` of writing, after it if `late`, and at every later step."""
    calls = count()

    def stopping(step: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **options: object) -> object:
            over = next(calls) >= last
            if over and not late:
                stop()
            done = step(*arguments, **options)
            if over:
                stop()
            return done
        return call

    for name in STEPS:
        patch.setattr(os, name, stopping(getattr(os, name)))


def interrupt() -> None:
    raise KeyboardInterrupt


def run_interrupted(command: list[str], last: int, late: bool) -> int:
    """Exit status of a command that Ctrl-C stops at a step of writing."""
    with pytest.MonkeyPatch.context() as patch:
        stop_at(patch, last, late, interrupt)
        return main(command)


def run_killed(command: list[str], last: int, late: bool) -> int:
    """Exit status of a process of its own that is gone, with nothing put away, at a step of writing."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            with pytest.MonkeyPatch.context() as patch:
                stop_at(patch, last, late, lambda: os._exit(KILLED))
                status = main(command)
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def check_files(folder: Path, parts: bool) -> None:
    """Every file is whole; nothing else is there, but for `parts` of files if processes were killed."""
    for path in (path for path in folder.rglob("*") if path.is_file()):
        if path.suffix == ".part":
            assert parts and path.name.startswith("."), path
        elif path.parent.name == "runs" and path.suffix == ".csv":
            assert len(read_csv(path).time_s) == 100
        elif path.name == "columns.toml":
            assert load_map(path)["q1_rad"].unit == "deg"
        elif path.name == "rig.toml":
            assert load_rig(path).mechanism.model == "joint1"
        elif path.name == "model.json":
            load_model(path)
        elif path.suffix == ".json":
            assert json.loads(path.read_bytes())["schema"] == {
                "fit": "legid.fit/1", "tune": "legid.tuning/1", "diagnosis": "legid.diagnosis/1",
                "validation": "legid.validation/1"}[path.stem]
        elif path.suffix == ".html":
            assert path.read_text(encoding="utf-8").rstrip().endswith("</html>")
        else:
            assert path.name in LOGS, path


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), *(
    pytest.param(seed, marks=pytest.mark.study) for seed in range(2, 8))])
def test_what_is_left_is_whole_and_the_next_command_takes_it(
        seed: int, here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_logs(here)
    rng = np.random.default_rng(seed)
    stopped = killed = 0
    for name in ["import", *rng.choice(list(COMMANDS), 7, p=(0.35, 0.2, 0.1, 0.15, 0.2))]:
        way = [run_interrupted, run_killed][rng.integers(2)]
        command = list(COMMANDS[name])
        if name == "import":  # some of the files, in any order, and again over what is there
            command[1:4] = rng.permutation(LOGS)[:rng.integers(1, 4)]
            command += ["--force"] * int(rng.integers(2))
        status = way(command, int(rng.integers(MOST_STEPS)), bool(rng.integers(2)))
        said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("legid ")]
        killed += status == KILLED
        stopped += said == [f"legid {name}: interrupted"]
        if status != KILLED:
            assert len(said) == (status != 0) and "internal error" not in str(said), said
        if status == 2:
            assert any(f"{lacking}: " in said[0] for lacking in [*RUNS, "model.json"]), said
        check_files(here, killed > 0)
    assert stopped + killed
    for name in ("import", "tune", "fit", "validate", "diagnose", "validate"):
        assert main(COMMANDS[name]) == 0, capfd.readouterr().err
    check_files(here, killed > 0)
    assert sum(path.suffix != ".part" for path in here.rglob("*") if path.is_file()) == 16
