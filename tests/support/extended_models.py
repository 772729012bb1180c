"""The emulated leg's true parameters as a model file, extended, simulated by command, and the plant that judges it."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from daq import load_rig
from daq.recording import read_plan, write_plan
from daq.runs import read_csv
from experiments.emulation import EFFECTS, LegBody
from experiments.excite import random_multisine
from experiments.judge import model_of
from experiments.models import EffectValue, Model, mechanism_settings, save_model
from tests.support.fits import synthetic_fit
from tests.support.paths import DEMO_RIG as RIG
from tests.support.shell import typed

REACH = ((-0.6, 0.6), (-1.5, 1.5))


def model_with(*effects: EffectValue) -> Model:
    """The plant's true parameters, extended."""
    plain = model_of(synthetic_fit(), mechanism_settings(load_rig(RIG)), "zero", ["a"],
                     datetime(2026, 1, 1, tzinfo=UTC))
    count = 9 + sum(len(e.sizes) + len(e.shapes) for e in effects)
    covariance = tuple(tuple(1e-8 * (i == j) for j in range(count)) for i in range(count))
    noise = {"gyro_radps": 0.005, "accel_mps2": 0.05, "torque_nm": 0.02, "encoder_rad": 4e-4}
    return msgspec.structs.replace(plain, effects=effects, covariance=covariance, noise=noise, gear_ratio=50.0,
                                   reach=REACH)


def run_of(model: Model, folder: Path, *more: str, seconds: float = 8.0) -> Mapping[str, np.ndarray[Any, Any]]:
    """Columns of `legid simulate` under a plan at 200 Hz; the run stays in run.csv."""
    save_model(model, folder / "m.json")
    if not (folder / "plan.csv").exists():
        write_plan(random_multisine(5, seconds, 0.6, rate_hz=200.0), folder / "plan.csv")
    (folder / "run.csv").unlink(missing_ok=True)  # a run is never overwritten
    typed("simulate", folder / "m.json", "--plan", folder / "plan.csv", "--out", folder / "run.csv", *more)
    return read_csv(folder / "run.csv", load_rig(RIG)).columns


def plant_motion(name: str, folder: Path) -> np.ndarray[Any, Any]:
    """Angles (N, 2) of the emulated leg that hides `name`, under the same plan."""
    plant, motion = EFFECTS[name].plant(LegBody()), []
    state = plant.step(1e-9, 0.0)
    for torque in read_plan(folder / "plan.csv").torque_nm:
        motion.append((state.q1, state.q2))
        state = plant.step(0.005, torque)
    return np.array(motion)


def assert_moves_as_the_plant(model: Model, name: str, folder: Path) -> None:
    """A simulation's motion is the plant's that hides `name`, much nearer than without the extension."""
    extended, truth, plain = run_of(model, folder), plant_motion(name, folder), run_of(model_with(), folder)
    for j, column in enumerate(("q1_rad", "q2_rad")):
        error, without = (np.sqrt(np.mean((run[column] - truth[:, j]) ** 2)) for run in (extended, plain))
        assert error < 0.03 * np.ptp(truth[:, j]) and error < 0.4 * without


def noisy_run(model: Model, folder: Path) -> Path:
    """The rig file for a run of m.json with noise; plain.json is the model without its extension."""
    run_of(model, folder, "--noise-seed", "3")
    (folder / "rig.toml").write_text(RIG.read_text().replace("rate_hz = 250.0", "rate_hz = 200.0"))
    save_model(model_with(), folder / "plain.json")
    return folder / "rig.toml"
