"""Levels of `[noise]`: for all encoders or for each, and what a joint without a motor may lack."""

from dataclasses import replace

import numpy as np
import pytest

from daq.rig import parse_rig
from experiments.session.setup import fit_options
from experiments.workflows import fit_runs
from tests.support.mujoco_leg import random_leg, record

LEG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[noise]\n'


@pytest.mark.parametrize("text, known", [
    ("encoder_rad = 0.001", {"encoder_rad": 0.001}),
    ("encoder_rad = [0.001, 0.004]", {"encoder1_rad": 0.001, "encoder2_rad": 0.004}),
    ("accel_mps2 = 0.05", {"accel_mps2": 0.05}),
    ("accel_mps2 = [0.05, 0.08]", {"accel_x_mps2": 0.05, "accel_y_mps2": 0.08}),
    ("torque_nm = [0.02]", {"torque2_nm": 0.02}),
    ("passive_nm = 0.03\ntorque_nm = 0.02", {"passive_nm": 0.03, "torque_nm": 0.02}), ("", {})])
def test_what_the_rig_declares_is_what_the_fit_knows(text: str, known: dict[str, float]) -> None:
    rig = parse_rig(LEG + text)
    assert fit_options(rig, "encoder", {}).noise == known
    assert rig.noise.encoder_of(-1) == known.get("encoder2_rad", known.get("encoder_rad"))


def test_correlations_are_known_by_rising_joint() -> None:
    arm = LEG.replace("[2]", "[2, 1]") + "torque_nm = [0.1, 0.2]\naccel_correlation = -0.2\n"
    options = fit_options(parse_rig(arm + "torque_correlation = [[1.0, 0.3], [0.3, 1.0]]"), "imu", {})
    assert options.noise == {"torque1_nm": 0.1, "torque2_nm": 0.2}
    assert (options.accel_correlation, options.torque_correlation) == (-0.2, ((1.0, 0.3), (0.3, 1.0)))
    assert [options.torque_noise(j, True) for j in (0, 1)] == [0.1, 0.2] and options.torque_noise(0, False) is None


def test_each_encoder_is_believed_as_far_as_it_is_declared() -> None:
    """The pivot's encoder is twenty times as bad as the knee's. Told so, the fit finds what the torque's noise is; told
    that both are as bad, it gives a part of that to the knee's encoder; told the other way round, it is far off."""
    rng = np.random.default_rng(5)
    leg = random_leg(rng)
    run = record(leg, rng, seconds=20.0, torque=0.02)
    data = [replace(run, columns={**run.columns, "q1_rad": run["q1_rad"] + 0.01 * rng.normal(size=len(run)),
                                  "q2_rad": run["q2_rad"] + 0.0005 * rng.normal(size=len(run))})]
    alike, told, swapped = (
        fit_runs(data, parse_rig(LEG + f"encoder_rad = {levels}"), sensors="encoder", choose=False).result
        for levels in ("0.01", "[0.01, 0.0005]", "[0.0005, 0.01]"))
    assert told.noise["torque_nm"] == pytest.approx(0.02, rel=0.1) and alike.noise["torque_nm"] < 0.017
    assert np.all(np.abs(told.beta - leg.beta())[:5] < 4.0 * told.std[:5])
    assert np.abs(swapped.beta - leg.beta())[0] > 0.2 * leg.beta()[0]
