"""Starts of records in which the mechanism is not alone are left out with a line; all others stay."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daq import Dataset
from daq.rig import parse_rig
from experiments.session import prepare
from tests.support.driven_pendulum import pendulum_run
from tests.support.motions import pendulum
from tests.support.servo_joint import servo_run

JOINT = '[mechanism]\nmodel = "joint1"\nactuated = {}\n'
FREE, DRIVEN = JOINT.format([]), JOINT.format([1])


def swing(hold_s: float, start: float, rate_hz: float, friction: tuple[float, float]) -> Dataset:
    """A pendulum that a not quite steady hand holds at `start` [rad] for so long, of inertia 0.02 kg m^2."""
    time = np.arange(round(14.0 * rate_hz)) / rate_hz
    free = time >= hold_s
    angle = start + 0.004 * np.sin(2.0 * np.pi * 1.3 * time) + 1e-4 * np.random.default_rng(3).normal(size=time.size)
    angle[free] = pendulum(time[free] - hold_s, lambda t: 0.0, start, 0.0, friction, 40.0)
    return Dataset("swing", rate_hz, time, {"q1_rad": np.round(angle / 1e-3) * 1e-3})


def braked(hold_s: float) -> Dataset:
    """A driven joint that a brake holds first, against gravity: the drive is on, and its torque does nothing."""
    time = np.arange(1500) / 100.0
    torque = 2.0 * np.sin(2.0 * np.pi * 0.5 * time) + 1.5 * np.sin(2.0 * np.pi * 1.1 * time)
    free = time >= hold_s
    angle = np.full(time.size, 0.7)
    angle[free] = solve_ivp(lambda t, x: [x[1], (np.interp(t, time, torque) - 4.0 * np.sin(x[0]) - 0.3 * x[1]) / 0.2],
                            (hold_s, 15.0), [0.7, 0.0], t_eval=time[free], max_step=0.01).y[0]
    return Dataset("braked", 100.0, time, {"q1_rad": angle + 1e-4 * np.random.default_rng(2).normal(size=time.size),
                                           "tau1_nm": torque})


@pytest.mark.parametrize("run, rig, fixed, hold_s", [
    (swing(2.0, 1.1, 100.0, (0.3, 0.2)), FREE, {"beta2": 0.08}, 2.0),
    (swing(4.3, 0.5, 50.0, (0.2, 0.1)), FREE, {"beta2": 0.08}, 4.3),
    (braked(1.6), DRIVEN, {}, 1.6)], ids=["a hand", "a longer hand", "a brake"])
def test_a_start_that_the_mechanism_cannot_explain_is_left_out(
        run: Dataset, rig: str, fixed: dict[str, float], hold_s: float) -> None:
    (found,) = prepare([run], parse_rig(rig), fixed=fixed).setup.datasets
    (fault,) = found.readings
    assert (fault.what, fault.done) == ("start", "left_out") and "no motion of the mechanism alone" in str(fault)
    assert hold_s - 0.05 <= fault.size <= hold_s + 0.8
    good = found.time_s >= fault.size
    np.testing.assert_array_equal(found["q1_rad"][good], run["q1_rad"][good])
    assert np.isnan(found["q1_rad"][~good]).all()
    (as_read,) = prepare([run], parse_rig(f"{rig}[sampling]\nas_read = true\n"), fixed=fixed).setup.datasets
    assert not as_read.gap().any() and [one.what for one in as_read.readings] == ["start"]


@pytest.mark.parametrize("run, rig, fixed", [
    (swing(0.0, 2.4, 100.0, (0.3, 0.2)), FREE, {"beta2": 0.08}),
    (swing(0.0, 0.4, 30.0, (0.8, 0.4)), FREE, {"beta2": 0.08}),
    (pendulum_run("r", 4), DRIVEN, {}), (pendulum_run("r", 5, drag=0.02), DRIVEN, {}),
    (servo_run(), DRIVEN + "[servo]\ngain = 4.0\ndamping = 0.1\nlimit = 100.0\n", {}),
    (Dataset("rest", 50.0, np.arange(600) / 50.0, {
        name: np.append(np.full(300, x[0]), x) for name, x in pendulum_run("r", 6).columns.items()}),
     DRIVEN, {})], ids=["a wide swing", "a short swing", "driven", "with drag", "a servo", "rest first"])
def test_a_start_that_the_mechanism_can_make_stays(run: Dataset, rig: str, fixed: dict[str, float]) -> None:
    (found,) = prepare([run], parse_rig(rig), fixed=fixed).setup.datasets
    assert not [fault for fault in found.readings if fault.what == "start"]
