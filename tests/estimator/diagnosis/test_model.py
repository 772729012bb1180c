"""Re-fits of effects hidden by the bench's own integrator: each comes out at its size."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray
from pytest import MonkeyPatch, approx, mark, raises
from scipy.integrate import solve_ivp

from daq import Dataset
from estimator import Effect, FitError, FitOptions, fit
from estimator.diagnosis import model as models
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.error_table import measure
from estimator.diagnosis.model import (
    Model,
    begin_afresh,
    converge_runs,
    gain_over,
    nominal_model,
    refit,
    smooth,
)
from estimator.diagnosis.residual_signature import signature
from estimator.diagnosis.small_faults import without_small_faults
from estimator.diagnosis.tolerances import with_tolerances
from estimator.effects import Backlash, TorqueDelay
from estimator.effects.joint_elasticity import JointElasticity
from estimator.effects.load_dependent_friction import LoadDependentFriction
from estimator.effects.torque_ripple import TorqueRipple
from estimator.fitting import converge_motion, fit_nominal
from estimator.likelihood import LatentProblem, Latents, Noise, Stage, State, free_run
from estimator.model import joint1, leg2
from estimator.prediction import per_value, white_noise
from estimator.score import default_tolerances
from estimator.signals import IMU_COLUMNS, SignalSet
from evidence.blind.cases import Case, DrawnCase, draw_case
from evidence.blind.effects import MOTOR_INERTIA
from evidence.blind.leg import stack
from evidence.blind.measure import RATE_HZ, disturb, read
from evidence.blind.physics import integrate
from tests.support.driven_pendulum import mechanism, pendulum_run
from tests.support.mujoco_leg import random_leg
from tests.support.mujoco_leg import record as run_of

COUNT, RUNS = 800, 4
PEAK_NM = 0.6


def drawn(effect: str) -> DrawnCase:
    """Leg, sensors and torque plans of the bench; what it would hide is not used."""
    return draw_case(Case("single", (effect,), seed=21), {effect: 0.1}, 0.1)


def record(case: DrawnCase, plant: Mapping[str, float], late_s: float = 0.0) -> list[Dataset]:
    """Runs of the leg with `plant` in it; the shunt shows the torque `late_s` after it acted."""
    grid, rng = np.arange(COUNT) / RATE_HZ, default_rng(21)
    acting, shown = (np.array([plan.at(grid + ahead, PEAK_NM) for plan in case.torques[:RUNS]])
                     for ahead in (late_s, 0.0))
    extra: dict[str, NDArray[np.float64]] = {name: np.full(RUNS, value) for name, value in plant.items()}
    motion = integrate(stack([case.leg] * RUNS), acting.T, step=1e-3, extra=extra)
    out = []
    for k in range(RUNS):
        columns = disturb(read(motion, k, shown[k], {}, case.sensors), case.sensors.torque * rng.normal(size=COUNT),
                          case.sensors, rng)
        time_s = columns.pop("time_s")
        out.append(Dataset(f"r{k + 1}", RATE_HZ, time_s, columns))
    return out


def fitted(case: DrawnCase, data: list[Dataset], effect: Effect, afresh: bool = False) -> tuple[Model, Model]:
    """Nominal fit, and the fit with the effect."""
    split = split_runs(data, leg2(lever_arm=case.sensors.lever), FitOptions(), case.sensors.gear)
    nominal = nominal_model(split)
    start = np.zeros(effect.count)
    if afresh:
        start[0] = 0.1
    return nominal, refit(begin_afresh(nominal) if afresh else nominal, [(effect, start)], 40)


def test_a_soft_gear_is_found_with_the_friction_of_its_motor() -> None:
    case, compliance = drawn("joint_elasticity"), 0.25
    data = record(case, {"shaft": 1.0 / compliance, "shaft_damping": 0.003, "motor_inertia": MOTOR_INERTIA})
    _, model = fitted(case, data, JointElasticity(1), afresh=True)
    ((found, viscous, coulomb, inertia),) = model.sizes()
    assert found == approx(compliance, rel=0.03)
    assert viscous + model.state.beta[6] == approx(case.leg.viscous2, rel=0.1)
    assert coulomb + model.state.beta[8] == approx(case.leg.coulomb2, rel=0.1)
    assert 0.5 * MOTOR_INERTIA < inertia < 2.0 * MOTOR_INERTIA  # near the resonance samples see too little of it
    assert model.state.noise.encoder[1] < case.sensors.count_rad  # with friction on the link: thirty times as much


def test_play_is_found_and_its_motion_smoothed_on_a_new_run() -> None:
    case, gap = drawn("backlash"), 0.08
    data = record(case, {"shaft": 200.0, "shaft_damping": 0.12, "motor_inertia": MOTOR_INERTIA, "gap": gap})
    split = split_runs(data, leg2(lever_arm=case.sensors.lever), FitOptions(), case.sensors.gear)
    new = split.names.index(data[-1].name)  # the others hold the strongest motion, in which play is seen best
    split = replace(split, train=tuple(i for i in range(len(data)) if i != new), test=(new,))
    effect = Backlash(1)
    start = np.array([0.5 * gap, 0.0, 0.0, 0.0, 0.1])
    nominal = nominal_model(split)
    model = refit(nominal, [(effect, start)], 40)
    # flanks that samples cross to and fro keep it from settling: 0.074 after 20 steps, 0.077 after 300, and one
    # processor's rounding takes another way there than another's
    assert model.sizes()[0][0] == approx(gap, rel=0.1)
    picture = signature(nominal, model, effect)
    assert picture is not None and picture.y_label == "reading of encoder2"
    assert np.ptp(picture.curve) == approx(gap, rel=0.2)  # a step from one flank to the other
    # the law is a step of the torque: sought at once from filtered motion it leaves ten times as much
    fitted = smooth(model, split.test[0])
    problem, state = fitted.problem, fitted.state
    assert per_value(problem, state) < 2.0


@mark.parametrize("late_s", [0.0098, 0.004, -0.006])
def test_a_late_torque_is_found_between_samples(late_s: float) -> None:
    case = drawn("torque_delay")
    _, model = fitted(case, record(case, {}, late_s), TorqueDelay())
    ((found,),) = model.sizes()
    assert found == approx(late_s, abs=6e-4)  # noise interpolated between samples would draw it to 5 ms


@mark.parametrize("tolerances", [None, default_tolerances()])
def test_a_diagnosis_and_a_fit_of_the_same_runs_have_one_nominal_model(tolerances: dict[str, tuple[float, ...]] | None
                                                                       ) -> None:
    """One optimum, one step to the likeliest faults of readings, and one interval; also of readings without these."""
    rng = default_rng(6)
    leg = random_leg(rng)
    runs = [replace(run_of(leg, rng, seconds=8, hold="zero", high=8.0), name=f"r{k}") for k in range(4)]
    m, options = leg2(lever_arm=leg.lever), FitOptions(hold="auto", tolerances=tolerances)
    split = split_runs(runs, m, options)
    seen = [next(d for d in runs if d.name == split.names[i]) for i in split.train]
    found, near = fit(seen, m, options), fit_nominal(seen, m, options)
    best = fit(seen, m, replace(options, tolerances=None))  # the optimum
    assert near.state is not None and near.state.converged, "else the readings were not those of the split"
    model = nominal_model(replace(split, mechanism=near.mechanism, options=replace(
        options, hold=near.hold, smoothing_velocity="given")), near.state)
    assert model.state.beta / best.std == approx(best.beta / best.std, rel=0.0, abs=1e-6)
    for one, apart, allowed in ((model, 1e-6, 0.01), (without_small_faults(model), 0.1, 0.1)):
        values, covariance = with_tolerances(one)
        assert np.abs(values - found.beta) / found.std == approx(0.0, abs=apart)
        assert np.sqrt(np.diag(covariance)) / found.std == approx(1.0, rel=allowed)


def test_a_few_steps_end_at_the_likeliest_motion() -> None:
    """An arm's encoder scale of 8 %: after two steps its deviance was 6,000 above that of the likeliest motion."""
    case = drawn("torque_delay")
    split = split_runs(record(case, {}, 0.02), leg2(lever_arm=case.sensors.lever), FitOptions(), case.sensors.gear)
    nominal = nominal_model(split)
    model = refit(nominal, [(TorqueDelay(), np.array([0.04]))], 2, hold_shapes=True)
    again = replace(model, state=converge_motion(model.problem, model.state))
    assert gain_over(again, model) == approx(0.0, abs=1.0)
    assert gain_over(replace(model, state=replace(model.state, x=nominal.state.x)), model) > 100.0


def test_an_effect_is_sought_at_the_nominal_parameters_where_no_fit_of_them_converges(
        monkeypatch: MonkeyPatch) -> None:
    """A servo's leg against a stiff stop takes its torque for noise with every effect, and with none."""
    case = drawn("torque_delay")
    split = split_runs(record(case, {}, 0.008), leg2(lever_arm=case.sensors.lever), FitOptions(), case.sensors.gear)
    nominal, delay = nominal_model(split), [(TorqueDelay(), np.zeros(1))]
    monkeypatch.setattr(models, "mistaken_torques", lambda *_: [1])
    with raises(FitError, match="torque for noise"):
        refit(nominal, delay)
    beta = np.ravel(case.leg.beta())
    unknown = replace(nominal, state=replace(nominal.state, beta=beta, covariance=np.full((9, 9), np.inf)))
    model = refit(unknown, delay)
    assert np.array_equal(model.state.beta[:9], beta)
    assert model.sizes()[0] == approx(0.008, abs=2e-3)
    assert np.isinf(model.std()[:9]).all() and 0.0 < model.std()[9] < 1e-3
    further = refit(model, [*zip(model.effects, model.sizes())])  # grown sets begin there
    assert np.array_equal(further.state.beta[:9], beta)


def test_no_run_changes_the_motion_of_another() -> None:
    case = drawn("torque_delay")
    split = split_runs(record(case, {}, 0.0), leg2(lever_arm=case.sensors.lever), FitOptions(), case.sensors.gear)
    model = nominal_model(split)
    problem, x = model.problem, model.state.x
    begin = problem.run_starts[1]
    far = np.where(np.arange(problem.total)[:, None] < begin, x.v + 3.0, x.v + 1e-3)
    near = np.where(np.arange(problem.total)[:, None] < begin, x.v, x.v + 1e-3)
    one, other = (converge_runs(model.split, problem, replace(model.state, x=replace(x, v=v))) for v in (far, near))
    assert np.array_equal(one.x.q[begin:], other.x.q[begin:])
    assert gain_over(model, replace(model, state=other)) == approx(0.0, abs=1.0)


def test_a_fast_ripple_is_simulated_freely() -> None:
    case, amplitude, gear = drawn("torque_ripple"), 0.12, 50.0
    grid = np.arange(COUNT) / RATE_HZ
    torque = case.torques[0].at(grid, PEAK_NM)[:, None]
    plant = {"ripple": amplitude, "ripple_order": 2.0, "ripple_phase": 0.0, "gear": gear}
    motion = integrate(stack([case.leg]), torque, step=5e-4, extra={k: np.full(1, v) for k, v in plant.items()})
    seen = read(motion, 0, torque[:, 0], {}, case.sensors)
    driven = np.column_stack([np.zeros(COUNT), torque[:, 0]])
    signals = SignalSet("r", RATE_HZ, grid, np.column_stack([np.full(COUNT, np.nan), seen["q2_rad"]]), driven,
                        {name: seen[name] for name in IMU_COLUMNS})
    stage = Stage((0,), (0.0,), (0.0,), np.array([[-1.0, 1.0], [-1.0, 1.0]]), gear)
    problem = LatentProblem([signals], leg2(lever_arm=case.sensors.lever), "linear", stage,
                              [TorqueRipple(1), TorqueRipple(1)])
    # what the bench hides has 0.3 sin(2 phase + 0.7) beside its first order
    second = 0.3 * amplitude * np.array([np.cos(0.7), np.sin(0.7)])
    sizes = [amplitude, 0.0, 2.0, *second, 4.0]
    x = Latents(np.column_stack([motion.q1, motion.q2]), np.column_stack([motion.w1, motion.w2]), driven)
    state = State(x, np.concatenate([np.ravel(case.leg.beta()), sizes]),
                  Noise(np.array([0.002, 0.02]), np.array([np.inf, 2e-4]), np.array([0.005]),
                        np.full((1, 2), 0.05)), np.eye(15))
    moved = replace(state, x=replace(x, q=x.q + 0.05 * np.sin(7.0 * grid)[:, None]))  # where a guess may well stand
    moved.x.q[0] = x.q[0]
    run = free_run(problem, moved, driven)
    # 200 periods a rad: after two seconds an error of a hundredth of a rad is another ripple
    assert np.abs(run.q - x.q)[:100].max() < 0.02 * np.ptp(x.q[:100, 1])


def test_friction_under_a_load_that_follows_from_acceleration_is_simulated_freely() -> None:
    """A servo under a voltage: V = L + mu |L| s + viscous qd + coulomb s with the load L = J qdd + G sin(q), so that
    L = (V - viscous qd - coulomb s) / (1 + mu s sign(L)); the divisor is positive, and so L has the numerator's sign.
    """
    inertia, moment, viscous, coulomb, mu, rate_hz, count = 0.05, 0.12, 0.15, 0.1, 0.43, 25.0, 150
    grid = np.arange(count) / rate_hz
    volts = 1.5 * np.sin(3.0 * grid) + 0.8 * np.sin(7.0 * grid + 1.0)

    def rates(t: float, y: NDArray[np.float64]) -> list[float]:
        sign = np.tanh(y[1] / 0.02)
        driving = np.interp(t, grid, volts) - viscous * y[1] - coulomb * sign
        load = driving / (1.0 + mu * sign * np.sign(driving))
        return [y[1], (load - 9.81 * moment * np.sin(y[0])) / inertia]

    truth = solve_ivp(rates, (0.0, grid[-1]), [0.1, 0.0], t_eval=grid, rtol=1e-6, atol=1e-8, max_step=2e-3).y
    mechanism = joint1(voltage=True, velocity_scale=0.05)
    signals = SignalSet("r", rate_hz, grid, truth[0][:, None], volts[:, None], {})
    stage = Stage((0,), (0.0,), (0.0,), np.array([[-1.0, 1.0]]), 1.0)
    problem = LatentProblem([signals], mechanism, "linear", stage, [LoadDependentFriction(0)])
    x = Latents(truth[0][:, None], truth[1][:, None], volts[:, None])
    noise = Noise(np.array([0.1]), np.array([1e-3]), np.ones(1), np.ones((1, 2)))
    state = State(x, np.array([inertia, moment, viscous, coulomb, mu]), noise, np.eye(5))
    run = free_run(problem, state, volts[:, None])
    assert np.abs(run.q[:, 0] - truth[0]).max() < 0.06 * np.ptp(truth[0])
    wrong = replace(state, beta=state.beta * np.array([1.0, 1.0, 1.0, 0.5, 1.0]))
    whole, short = (free_run(problem, wrong, volts[:, None], horizon) for horizon in (np.inf, 0.2))
    assert whole is not None and short is not None
    off, near = (np.abs(found.q[:, 0] - truth[0]) for found in (whole, short))
    assert near[::5].max() == 0.0  # every piece of five samples starts from the motion that was given
    assert near.max() < 0.3 * off.max()


@mark.parametrize("workers", [1, 2])
def test_a_model_that_is_measured_twice_is_as_likely_twice(workers: int) -> None:
    """Where a joint rests is found once, with the nominal model: all explanations have the same weights."""
    split = split_runs([pendulum_run(f"r{k}", 70 + k) for k in range(8)], mechanism(), FitOptions(sensors="encoder"),
                       workers=workers)
    nominal = nominal_model(split)
    assert len(split.test) == 2 and set(split.test) <= set(nominal.split.stiction)
    table = measure([nominal, nominal], 0, white_noise(nominal.state.noise), default_rng(0), [0])
    assert table.agreement.tolist() == [[0.0, 0.0]] * 2 and table.error(1) == table.error(0) < 1.5
    again = measure([replace(nominal)], 0, white_noise(nominal.state.noise), default_rng(0), [0])
    assert again.error(0) == approx(table.error(0), rel=1e-9)
