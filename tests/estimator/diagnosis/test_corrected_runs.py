"""`corrected`: small faults of sensors are found together and taken off; larger ones, and laws, stay."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from estimator import FitOptions
from estimator.diagnosis.context import DiagnosisContext, scored
from estimator.diagnosis.corrected_runs import Corrected, corrected, unbiased
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import gain_over, nominal_model
from estimator.effects import battery, library
from estimator.likelihood import Candidate
from estimator.model import leg2
from estimator.score import BEYOND, default_tolerances
from tests.support.lab_readings import SMALL, read_with
from tests.support.mujoco_leg import random_leg
from tests.support.timed_leg import Timing, record


@cache
def context_of(faults: tuple[tuple[str, float], ...], spring: float = 0.0, stated: bool = True) -> DiagnosisContext:
    rng = np.random.default_rng(3)
    leg = random_leg(rng)
    runs = [read_with(record(leg, rng, Timing(100.0), seconds=8.0, spring=spring, name=f"r{k}"), dict(faults))
            for k in range(4)]
    options = FitOptions(hold="zero", tolerances={} if stated else None)
    split = split_runs(runs, leg2(lever_arm=leg.lever), options)
    effects = library(split.mechanism, True, split.encoders)[0]
    candidates = [Candidate(e, shape) for e in effects for shape in e.grid()]
    named = len(candidates)
    candidates += [Candidate(e) for e in battery(split.mechanism, True, split.encoders)]
    return scored(nominal_model(split), candidates, named, np.random.default_rng(0), lambda stage, share: None)[0]


def result_of(context: DiagnosisContext) -> Corrected | None:
    return corrected(context, context.nominal, unbiased(context, context.nominal, context.scores))


def test_all_small_faults_are_found_together_and_the_readings_are_without_them() -> None:
    context = context_of(tuple(SMALL.items()))
    found = result_of(context)
    sizes = {f"{one.effect.key}.{size.name}": float(value)
             for one in found.faults for size, value in zip(one.effect.sizes, one.size, strict=True)}
    named = {"gyro_scale": "gyro_scale.scale_error", "accelerometer_bias.x": "accelerometer_bias.bias_x",
             "accelerometer_bias.y": "accelerometer_bias.bias_y", "imu_misalignment": "imu_misalignment.angle",
             "imu_lever_arm": "imu_lever_arm.excess", "torque_offset": "torque_offset.offset"}
    for fault, true in SMALL.items():
        tolerances = default_tolerances()[fault.partition(".")[0]]
        assert sizes[named[fault]] == pytest.approx(true, abs=0.3 * tolerances[0]), fault
    others = [one for one in found.faults if one.effect.key not in {n.partition(".")[0] for n in named.values()}]
    assert all(np.all(np.abs(one.size) < 0.5 * one.tolerance) for one in others)
    assert gain_over(context.nominal, found.nominal) > 200.0
    names = {i: s.run for i, run in enumerate(found.nominal.split.runs) for s in run}
    for i, run in enumerate(found.nominal.split.runs):  # those of test runs as well
        clean = context_of(()).split.runs[[s[0].run for s in context_of(()).split.runs].index(names[i])]
        error = np.abs(np.mean(run[0].imu["accel_y_mps2"] - clean[0].imu["accel_y_mps2"]))
        assert error < 0.02


@pytest.mark.parametrize("spring", [0.0, 0.6])
def test_right_sensors_and_a_law_alone_are_left_as_they_are(spring: float) -> None:
    assert result_of(context_of((), spring)) is None


def test_a_fault_beyond_its_tolerance_is_left_to_be_named() -> None:
    found = result_of(context_of((("gyro_scale", 0.06),)))
    assert found is None or all(np.all(np.abs(one.size) <= BEYOND * one.tolerance) and one.effect.key != "gyro_scale"
                                for one in found.faults)


def test_without_tolerances_nothing_is_taken_off() -> None:
    assert result_of(context_of(tuple(SMALL.items()), stated=False)) is None
