"""Columns in other units, put to every command that reads runs: refused in one line that says what to write."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset
from daq.runs import write_csv
from tests.support.models import write_model
from tests.support.mujoco_leg import random_leg, record
from tests.support.shell import Shell, document

DEGREES = 180.0 / np.pi
G = 9.80665
SPOILT = {
    "knee in degrees": ({"q2_rad": DEGREES}, 'name = "q2_rad" and unit = "deg" under [columns.q2_rad]'),
    "gyro in degrees a second": ({"gyro_radps": DEGREES}, 'unit = "deg/s" under [columns.gyro_radps]'),
    "accelerometer in g": ({"accel_x_mps2": 1 / G, "accel_y_mps2": 1 / G}, 'unit = "g" under [columns.accel_y_mps2]'),
}
Bench = Callable[[dict[str, float]], list[object]]


@pytest.fixture(scope="module")
def bench(module_path: Path) -> Bench:
    """Makes MODEL RUN --rig RIG of two runs whose columns are multiplied by these factors."""
    rng = np.random.default_rng(1)
    leg = random_leg(rng)
    runs = [record(leg, rng, seconds=8.0) for _ in range(2)]
    settings = {"model": "leg2", "actuated": [2], "lever_arm_m": leg.lever}
    write_model(module_path / "model.json", list(leg.beta()), settings)
    rig = module_path / "rig.toml"
    rig.write_text(f'[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\nlever_arm_m = {leg.lever}\n')

    def spoil(by: dict[str, float]) -> list[object]:
        paths = [module_path / f"{k}{'-'.join(by)}.csv" for k in range(2)]
        for path, run in zip(paths, runs):
            columns = {name: by.get(name, 1.0) * values for name, values in run.columns.items()}
            if not path.exists():
                write_csv(Dataset(path.name, run.rate_hz, run.time_s, columns), path)
        return [module_path / "model.json", *paths, "--rig", rig]

    return spoil


@pytest.mark.parametrize("command", ["fit", "validate", "compare", "diagnose"])
@pytest.mark.parametrize("what", SPOILT)
def test_columns_in_other_units(command: str, what: str, bench: Bench, shell: Shell) -> None:
    factors, remedy = SPOILT[what]
    model, *rest = bench(factors)
    before = {"validate": [model], "compare": [model, model]}.get(command, [])
    if command == "fit":
        rest.append("--method wls")
    assert remedy in shell.fails(command, *before, *rest, status=1)
    if command == "diagnose":
        found = document(command, *rest, status=1)
        assert found["verdict"] == "fit_failed" and remedy in found["sentence"] and not found["causes"]


def test_columns_as_they_should_be_are_validated(bench: Bench, shell: Shell) -> None:
    shell("validate", *bench({}))
    assert "[columns" not in shell.err
