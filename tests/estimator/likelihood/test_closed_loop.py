"""Free runs under a command: the loop makes the torque of the simulated motion, MuJoCo being the plant."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng
from pytest import approx, mark

from daq import Dataset
from estimator import Effect, FitOptions
from estimator.effects import Around, LawEffect, Points, Told, by_motion, classes
from estimator.effects.encoder_eccentricity import EncoderEccentricity
from estimator.effects.encoder_scale import EncoderScale
from estimator.free_runs import FittedModel
from estimator.likelihood import FreeRun, free_run
from estimator.model import leg2
from estimator.prediction import SmoothedRun, floor_errors, smooth, white_noise
from estimator.signals import encoder_of
from tests.support.mujoco_leg import Leg
from tests.support.servo_leg import COUNTS, ServoFaults, follow, with_torque

LEG = Leg(viscous=(0.02, 0.03), coulomb=(0.01, 0.02))
QUANTUM = 2.0 * np.pi / COUNTS
MODEL = FittedModel(replace(leg2(), followers=(1,), velocity_scale=0.02), "smooth", LEG.beta())
LOOPS = {"stiff": "gain = 20.0\ndamping = 0.3\n", "limited": "gain = 8.0\ndamping = 0.1\nlimit = 0.6\n",
         "slow": "gain = 5.0\ndamping = 0.15\nrate_hz = 50.0\n", "late": "gain = 6.0\ndamping = 0.1\ndelay_s = 0.02\n",
         "integrating": "gain = 5.0\ndamping = 0.15\nintegral = 3.0\n",
         "filtered": "gain = 6.0\ndamping = 0.3\nvelocity_filter_s = 0.01\ncommand_filter_s = 0.03\n"}


def recorded(loop: str, seed: int = 3) -> Dataset:
    """6 s of the leg behind one of LOOPS."""
    stated = dict(line.split(" = ") for line in LOOPS[loop].splitlines())
    said = {name: float(value) for name, value in stated.items()}
    return with_torque(follow(
        LEG, default_rng(seed), gain=said["gain"], damping=said["damping"], limit=said.get("limit", np.inf),
        loop_hz=said.get("rate_hz", 1000.0), seconds=6.0, amplitude=0.8,
        faults=ServoFaults(**{name: said.get(name, 0.0) for name in (
            "delay_s", "integral", "velocity_filter_s", "command_filter_s")})), LOOPS[loop])


def ran(one: SmoothedRun, horizon_s: float = np.inf) -> FreeRun:
    found = free_run(one.problem, one.state, one.drive, horizon_s)
    assert found is not None
    return found


@mark.parametrize("loop", LOOPS)
def test_a_free_run_follows_the_command_as_the_leg_did(loop: str) -> None:
    data = recorded(loop)
    one = smooth(MODEL, data, FitOptions(sensors="encoder"))
    assert one.problem.closed
    for horizon_s in (np.inf, 1.0):
        run = ran(one, horizon_s)
        error = np.sqrt(np.mean((run.q - one.problem.angles) ** 2, axis=0))
        assert (error < 3.0 * QUANTUM).all(), error / QUANTUM


@mark.parametrize("faults, heard", [
    (ServoFaults(encoder_scale=0.05), 1.0), (ServoFaults(log_scale=0.05), 0.0)])
def test_a_scale_is_wrong_for_the_loop_as_well_or_in_the_log_alone(faults: ServoFaults, heard: float) -> None:
    """The right one of both has no residual, and free runs that follow the command as the leg did."""
    data = with_torque(follow(LEG, default_rng(61), gain=8.0, damping=0.1, limit=0.6, seconds=6.0,
                              amplitude=0.8, faults=faults), "gain = 8.0\ndamping = 0.1\nlimit = 0.6\n")
    errors, misfits = {}, {}
    for place in (1.0, 0.0):
        model = replace(MODEL, parameters=np.append(LEG.beta(), [0.05, place]),
                        effects=(EncoderScale(1, by_law=True),))
        one = smooth(model, data, FitOptions(sensors="encoder"))
        readings, misfits[place] = ran(one).readings, one.misfit()
        errors[place] = [np.sqrt(np.mean((readings[encoder_of(j)] - one.problem.angles[:, j]) ** 2)) for j in range(2)]
    assert max(errors[heard]) < 3.0 * QUANTUM < errors[1.0 - heard][1]
    assert misfits[heard] < misfits[1.0 - heard] - 1000.0


def test_of_joints_with_and_without_loops_a_free_run_has_all_open() -> None:
    """The torque that acted is then that of the true motion, without what the encoder misread times the gain."""
    data = recorded("stiff")
    data = replace(data, columns={**data.columns, "tau1_nm": np.zeros(len(data))})
    model = replace(MODEL, mechanism=replace(MODEL.mechanism, actuated=(0, 1)))
    one = smooth(model, data, FitOptions(sensors="encoder"))
    assert one.problem.by_law and not one.problem.closed
    acted = one.problem.motor_torque(one.state.x, one.state.beta)[:, 1]
    inverse = MODEL.mechanism.inverse_dynamics(one.state.x.q, one.state.x.v, np.gradient(one.state.x.v, 0.01, axis=0),
                                               LEG.beta())[:, 1]
    read = np.std((one.problem.torque[:, 1] - inverse)[5:-5])
    assert np.std((acted - inverse)[5:-5]) < 0.7 * read


def test_a_wrong_parameter_is_what_the_command_makes_of_it_not_what_the_torque_does() -> None:
    """With a heavier lower link the knee still follows its command; under the recorded torque it does not."""
    data = recorded("stiff")
    wrong = LEG.beta()
    wrong[4] *= 1.3  # gravity of the lower link
    one = smooth(replace(MODEL, parameters=wrong), data, FitOptions(sensors="encoder"))
    closed = ran(one)
    bare = smooth(replace(MODEL, parameters=wrong), replace(data, loops={}, by_law=()), FitOptions(sensors="encoder"))
    assert not bare.problem.closed
    opened = ran(bare)
    errors = [np.sqrt(np.mean((run.q[:, 1] - one.problem.angles[:, 1]) ** 2)) for run in (closed, opened)]
    assert errors[0] < 0.2 * errors[1]


def test_noise_leaves_in_replicates_what_it_leaves_in_records() -> None:
    """The floor of a leg whose model is right is about the error of its free runs."""
    one = smooth(MODEL, recorded("stiff"), FitOptions(sensors="encoder"))
    error = np.sqrt(np.mean((ran(one).q - one.problem.angles) ** 2, axis=0))
    floor = floor_errors(one, default_rng(5), [np.inf], lambda signals: MODEL.problem(signals),
                         white_noise(one.state.noise))
    left = np.sqrt(np.mean(floor[0, :2] ** 2, axis=1))
    assert (error < 2.0 * left).all() and (error > 0.5 * left).all(), (error, left)


def test_commands_are_smooth_and_monotone_between_samples_and_stay_within_their_segment() -> None:
    time = np.arange(40) / 10.0
    angle = np.array([[*np.sin(time), *(time > 2.0)]])
    told = Told(angle, 2.0 * angle, np.repeat([0, 40], 40), 0.1)
    place = np.arange(1.0, 38.0) + 0.5
    error = np.abs(told.at(place, np.zeros((1, 1)))[0][0] - np.sin(0.1 * place))
    assert error.max() < 1e-3 and error.mean() < 2e-4  # of straight lines 1.2e-3 and 8e-4
    late, rate = told.at(place, np.full((1, 1), 0.05))
    assert late[0] == approx(np.sin(0.1 * place - 0.05)) and rate == approx(2.0 * late)
    stepped = told.at(40.0 + place, np.full((1, 1), 0.02))[0][0]
    assert stepped.min() == 0.0 and stepped.max() == 1.0 and (np.diff(stepped) >= 0.0).all()
    begin = np.array([40.0, 41.0])
    assert told.at(begin, np.full((1, 1), 0.3))[0][0] == approx([0.0, 0.0])


def test_a_loop_without_gain_is_no_explanation() -> None:
    """All parameters and the noise would be zero, too: the likelihood grows without end."""
    scale = {kind.name: kind for kind in classes()}["gain_scale"](1)
    assert scale.possible(np.array([-0.5])) and not scale.possible(np.array([-0.999]))


def test_slopes_of_effects_of_a_loop_are_differences_of_their_laws() -> None:
    one = smooth(MODEL, recorded("limited"), FitOptions(sensors="encoder"))
    view = one.problem.view(one.state.x, one.state.beta)
    at, kinds = view.gauss, {kind.name: kind for kind in classes()}
    assert at.commanded is not None
    by_record = replace(at, commanded=replace(at.commanded, closed=False))
    cases: list[tuple[Effect, list[float], Points]] = [(kinds[name](1), size, at) for name, size in (
        ("command_delay", [0.01]), ("input_limit", [0.7, 0.2]), ("supply_sag", [0.2]), ("command_dead_band", [0.02]),
        ("gain_scale", [0.1]), ("command_steps", [0.5, 0.03]))]
    cases += [(EncoderScale(1, by_law=True), [0.05, 0.0], by_record), (EncoderScale(1, by_law=True), [0.05, 1.0], at),
              (EncoderEccentricity(1, by_law=True), [0.2, 0.1, 0.0], by_record)]
    for effect, size, place in cases:
        assert isinstance(effect, LawEffect)
        found = by_motion(effect, Around(place, loops=True), np.array(size), view, 1)
        for field, h in (("q", 1e-5), ("v", 1e-5), ("a", 1e-3)):
            moved = [np.array(getattr(place, field)) for _ in range(2)]
            moved[0][1] += h
            moved[1][1] -= h
            sides: list[dict[str, Any]] = [{field: x} for x in moved]
            up, down = (effect.law(replace(place, **side), np.array(size), view) for side in sides)
            assert found[field] == approx((up - down) / (2.0 * h), abs=1e-6), (effect.key, field)
            assert np.abs(found[field]).max() > 0.0 or field == "a" or effect.name == "command_steps"
