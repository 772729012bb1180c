"""A noise level of each run's own: the plants, their noise and the least squares held against it are the tests'."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, fixture, mark

from daq import Dataset, FloatArray
from estimator import FitOptions, FitResult, fit
from estimator.fitting.run_levels import Column, RunLevels, run_levels
from estimator.likelihood import LatentProblem, Latents, Noise, NoiseScale
from estimator.model import ImuPlace, leg2
from estimator.signals import imu_columns, split_signals
from experiments.reports import fit_text
from tests.support.fits import document_of
from tests.support.mujoco_leg import Leg, random_leg, record
from tests.support.mujoco_tree import FRICTION_RADPS, Sensor, disturbed, move, random_tree, torques

LEVELS = {"gyro_radps": 0.01, "accel_x_mps2": 0.05, "accel_y_mps2": 0.05, "tau2_nm": 0.02, "q1_rad": 3e-4,
          "q2_rad": 3e-4}
NOISY, TIMES, RUNS, FITS = 1, 4.0, 4, 12
ROUND = 0.05
Plant = tuple[Leg, list[Dataset]]


@fixture(scope="module")
def plant() -> Plant:
    """A leg of MuJoCo and four runs of 8 s of it, without noise."""
    rng = default_rng(911)
    leg = random_leg(rng)
    return leg, [record(leg, rng, seconds=8.0, gyro=0.0, accel=0.0, torque=0.0, counts=2**24, friction_velocity=ROUND,
                        name=f"run{k}") for k in range(RUNS)]


def noisy(plant: Plant, rng: Generator, times: float, samples: int = 800) -> list[Dataset]:
    """Its runs with noise; the one that is NOISY has `times` as much, and so many samples."""
    runs = []
    for k, run in enumerate(plant[1]):
        if k == NOISY:
            run = run.part(slice(0, samples))
        noisy = times if k == NOISY else 1.0
        columns = {c: run[c] + noisy * s * rng.normal(size=len(run)) for c, s in LEVELS.items()}
        runs.append(replace(run, columns=columns))
    return runs


def fits(plant: Plant, times: float, sensors: str, count: int = FITS, samples: int = 800) -> list[FitResult]:
    mechanism = leg2(lever_arm=plant[0].lever, velocity_scale=ROUND)
    return [fit(noisy(plant, default_rng([3, k]), times, samples), mechanism, FitOptions(sensors=sensors))
            for k in range(count)]


def error(plant: Plant, found: list[FitResult]) -> FloatArray:
    return np.array([f.beta / plant[0].beta() - 1.0 for f in found])


@mark.parametrize("sensors, channels", [
    ("imu", {"gyro_radps": 0.01, "accel_y_mps2": 0.05, "torque2_nm": 0.02, "encoder2_rad": 3e-4}),
    ("encoder", {"torque2_nm": 0.02, "encoder1_rad": 3e-4, "encoder2_rad": 3e-4})])
def test_a_noisy_run_costs_no_more_than_leaving_it_out(plant: Plant, sensors: str, channels: dict[str, float]) -> None:
    found, quiet = fits(plant, TIMES, sensors), fits(plant, 1.0, sensors)
    assert all(f.converged for f in (*found, *quiet)) and all(f.run_noise is None for f in quiet)
    for name, level in channels.items():
        levels = np.mean([f.run_noise.levels[name] for f in found if f.run_noise is not None], axis=0)
        told = [TIMES if k == NOISY else 1.0 for k in range(RUNS)]
        assert levels == approx(level * np.array(told), rel=0.15)
    spread = [np.exp(np.mean(np.log(np.sqrt(np.mean(error(plant, some) ** 2, axis=0))))) for some in (found, quiet)]
    assert spread[0] < 1.4 * spread[1]  # with three runs of four 1.15; with one level for all of them 2.2
    held = np.abs(error(plant, found)) < np.array([f.half_width for f in found]) / plant[0].beta()
    assert np.mean(held) > 0.88


def test_a_short_run_among_runs_alike_gets_no_level_of_its_own(plant: Plant) -> None:
    assert all(f.run_noise is None for f in fits(plant, 1.0, "imu", 6, 60))


def levels_of(noise: FloatArray, lengths: list[int], taken: float = 0.0) -> RunLevels:
    """Of a gyro's noise; of the second run's samples, this many are taken by its latents."""
    column = Column("gyro_radps", noise**2, np.ones(noise.size), taken * np.eye(len(lengths))[1], "gyro", 0, 1.0, 0.0)
    return run_levels(column, np.cumsum([0, *lengths[:-1]]), np.array(lengths))


def test_runs_alike_get_levels_of_their_own_seldom() -> None:
    rng = default_rng(4)
    alarms = [levels_of(rng.normal(size=3000), [1000, 100, 900, 1000]).differ for _ in range(400)]
    assert sum(alarms) <= 12  # 1 % is chance


def test_what_differs_within_a_run_does_not_tell_runs_apart() -> None:
    """Loud and quiet seconds, drawn alike in every run."""
    rng = default_rng(5)
    alarms = [levels_of(np.repeat(np.exp(0.5 * rng.normal(size=32)), 125) * rng.normal(size=4000), [1000] * 4).differ
              for _ in range(200)]
    assert sum(alarms) <= 8


def test_levels_are_drawn_to_the_mean_by_what_a_run_does_not_know() -> None:
    rng, drawn, lengths = default_rng(6), [], [1000, 1000, 1000, 1000, 50]
    true = np.repeat([1.0, 1.5, 0.7, 1.2, 2.0], lengths)
    for _ in range(100):
        found = levels_of(true * rng.normal(size=4050), lengths)
        assert found.differ
        drawn.append(found.ratio / found.ratio[0])
    mean = np.mean(drawn, axis=0)
    assert mean[:4] == approx([1.0, 1.5, 0.7, 1.2], rel=0.03)
    assert 1.6 < mean[4] < 2.0


def test_runs_whose_noise_the_motion_took_say_nothing() -> None:
    """The second run's latents took 98 % of its samples: what little is left over is no quiet channel."""
    noise = np.repeat([1.0, 0.01, 1.0, 1.0], 1000) * default_rng(7).normal(size=4000)
    found = levels_of(noise, [1000] * 4, 980.0)
    assert not found.differ and found.ratio[1] > 0.9


@mark.parametrize("imus", [1, 2])
def test_the_likelihood_is_the_sum_of_runs_under_their_own_levels(plant: Plant, imus: int) -> None:
    """Objective, score and corner of all runs, each with a noise scale, are sums of those of single runs."""
    rng = default_rng(8)
    mechanism = leg2(lever_arm=plant[0].lever, velocity_scale=ROUND)
    runs = noisy(plant, rng, TIMES)
    if imus == 2:
        mechanism = mechanism.with_imus((ImuPlace(0, plant[0].lever), ImuPlace(1, 0.1)), (plant[0].l1,))
        runs = [replace(r, columns={**r.columns, **{c: rng.normal(size=len(r)) for c in imu_columns(1)}}) for r in runs]
    signals = split_signals(runs, mechanism, FitOptions())
    problem = LatentProblem(signals, mechanism, "smooth")
    x = Latents(*(rng.normal(size=(problem.total, 2)) for _ in range(3)))
    stiction = rng.uniform(size=(problem.total, 2, 2))
    ratio = rng.uniform(0.5, 2.0, size=(RUNS, 2 + 3 * imus))
    by_gyro, by_axis = ratio[:, 2 : 2 + imus], ratio[:, 2 + imus :].reshape(RUNS, imus, 2)
    by_axis[:, :, 1] = by_axis[:, :, 0]
    lengths = [len(s.time_s) for s in signals]
    rows, gyros, axes = (np.repeat(r, lengths, axis=0) for r in (ratio, by_gyro, by_axis))
    scale = NoiseScale(rows[:, [0, 0]], rows[:, [1, 1]], gyros.T, axes.swapaxes(0, 1))
    noise = Noise(np.array([0.1, 0.2]), np.array([np.inf, 1e-3]), np.array([0.01, 0.02])[:imus],
                  np.array([[0.05, 0.07], [0.06, 0.04]])[:imus], 0.3, np.array([[1.0, 0.4], [0.4, 1.0]]))
    beta, nothing = plant[0].beta(), np.zeros(2)
    parts = []
    for k, where in enumerate(np.split(np.arange(problem.total), problem.ends[:-1])):
        alone = LatentProblem([signals[k]], mechanism, "smooth")
        own = replace(noise, torque=noise.torque * ratio[k, 0], encoder=noise.encoder * ratio[k, 1],
                      gyro=noise.gyro * by_gyro[k], accel=noise.accel * by_axis[k], stiction=stiction[where])
        parts.append(alone.linearise(x.of(where), beta, own, predicted_misfit=nothing))
    whole = problem.linearise(x, beta, replace(noise, scale=scale, stiction=stiction), predicted_misfit=nothing)
    assert whole.objective == approx(sum(p.objective for p in parts), rel=1e-9)
    assert whole.gradient_beta == approx(sum(p.gradient_beta for p in parts), rel=1e-9)
    assert whole.corner == approx(sum(p.corner for p in parts), rel=1e-9)


def test_of_two_imus_the_one_that_is_noisier_in_a_run_gets_levels() -> None:
    """A leg without encoders; in one of four runs its shank's IMU, the second, is louder."""
    rng = default_rng(9)
    tree, sensors = random_tree(rng, (-1, 0), viscous=0.03, coulomb=0.04), [Sensor(0, 0.2), Sensor(1, 0.1)]
    mechanism = leg2(velocity_scale=FRICTION_RADPS).with_imus(tuple(ImuPlace(*s) for s in sensors), tuple(tree.length))
    runs = []
    for k in range(RUNS):
        motion = move(tree, torques(tree, rng, 8.0, 100.0, 0.35, (1,)), 100.0, sensors)
        run = disturbed(motion, (1,), 100.0, rng, name=f"run{k}")
        if k == NOISY:
            for name, level in zip(imu_columns(1), (0.005, 0.05, 0.05)):
                run.columns[name] += np.sqrt(TIMES**2 - 1.0) * level * rng.normal(size=len(run))
        runs.append(run)
    found = fit(runs, mechanism, FitOptions(sensors="imu", encoders=()))
    assert found.converged and found.run_noise is not None
    assert set(found.run_noise.levels) == {"gyro2_radps", "accel2_x_mps2", "accel2_y_mps2"}
    told = np.array([TIMES if k == NOISY else 1.0 for k in range(RUNS)])
    for name, level in zip(("gyro2_radps", "accel2_y_mps2"), (0.005, 0.05)):
        assert found.run_noise.levels[name] == approx(level * told, rel=0.15)
    lines = [line for line in fit_text(document_of(found)).splitlines() if "differs" in line]
    assert any(line.startswith("noise of runs differs: gyro of IMU 2 ") for line in lines)
    truth = tree.beta(mechanism)
    assert np.all(np.abs(found.beta - truth) < 4.0 * found.std)


def test_levels_by_run_are_told(plant: Plant) -> None:
    found = fits(plant, TIMES, "imu", 1)[0]
    told = document_of(found).document["noise_by_run"]
    assert told["runs"] == ["run0", "run1", "run2", "run3"]
    assert told["levels"]["gyro_radps"] == approx(found.run_noise.levels["gyro_radps"])
    line, = (line for line in fit_text(document_of(found)).splitlines() if "gyro" in line and "differs" in line)
    assert line.startswith("noise of runs differs: gyro 0.009")
    assert line.endswith("(run1); each run is weighted by its own level")
