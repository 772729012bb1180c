"""What changed on a leg of another engine, and on real records into which a fault is put exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from daq import Dataset, load_rig
from estimator.change import Change, detect_change
from estimator.change.contrast import contrast
from estimator.change.scores import RunScore
from estimator.change.structure import find_structure
from estimator.model import leg2
from estimator.options import FitOptions
from experiments.session import prepare
from tests.evidence.blind.records import FAULTS, RECORDS, RIGS
from tests.evidence.blind.servo import write_case
from tests.evidence.blind.stickslip import MAKERS, Readings, as_read
from tests.support.mujoco_leg import random_leg
from tests.support.paths import REAL
from tests.support.stick_slip_leg import TICK_S, move

REFERENCE = 4


def leg_runs(out: Path, changes: Callable[[Readings], None], heavier: float = 0.0) -> tuple[list[Path], Path]:
    """Eight runs of one leg, the last four with a change of the readings, or of link 1's mass [kg] at its centre."""
    rng = np.random.default_rng(11)
    leg = replace(random_leg(rng), coulomb=(0.01, 0.05))

    def logged(run: int) -> Readings:
        after = run >= REFERENCE
        own = replace(leg, m1=leg.m1 + heavier) if after else leg
        readings = as_read(move(own, rng, seconds=10.0, closed=run % 2 == 1, high=(3.0, 2.0, 1.2, 2.5)[run % 4]))
        if after:
            changes(readings)
        return {k: v[:: round(0.01 / TICK_S)] for k, v in readings.items()}

    write_case("leg", 1, out, map(logged, range(8)), rng, leg, "", [], 0.05)
    return sorted((out / "leg-1").glob("r*.csv")), out / "leg-1/rig.toml"


def change_of(files: list[Path], rig_file: Path) -> Change:
    setup = prepare(files, load_rig(rig_file)).setup
    return detect_change(setup.datasets[REFERENCE:], setup.datasets[:REFERENCE], setup.mechanism, setup.options)


def test_an_unchanged_leg_has_not_changed_and_says_what_it_would_have_shown(tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, lambda c: None))
    assert found.verdict == "no_change" and not found.causes
    offset = next(d for d in found.detectable if d.effect == "encoder_offset")
    assert 0.0 < offset.size < 0.03


@pytest.mark.parametrize(("name", "size"), [("encoder_offset", 0.03), ("gyro_scale", 0.03), ("torque_delay", 0.01),
                                            ("sensor_time_skew", 0.005)])
def test_a_changed_reading_is_named_with_its_size(name: str, size: float, tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, MAKERS[name][0](1.0)))
    cause = next(c for c in found.causes if c.effect == name)
    assert found.verdict in ("named", "partial", "one_of")
    assert cause.size[0].value == pytest.approx(size, rel=0.25)
    assert found.held_out is not None and sum(found.held_out.gain) > 0.0


def test_a_payload_on_link_1_is_among_the_causes(tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, lambda c: None, heavier=0.1))
    assert found.verdict != "no_change"
    assert {c.effect for c in found.causes} & {"payload", "parameter"}


def test_one_run_is_refused_with_a_remedy() -> None:
    time = np.linspace(0.0, 1.99, 200)
    data = Dataset("one", 100.0, time, {})
    found = detect_change([data], [data], leg2(), FitOptions())
    assert found.verdict == "fit_failed" and "give at least 2 of each" in found.sentence


def test_a_contrast_recovers_a_change_with_structure_in_the_reference() -> None:
    """Structure that both sessions have cancels; a change of one column comes back, of white noise's scatter."""
    rng = np.random.default_rng(3)
    structure, change, columns = rng.normal(size=6), 0.5, 6

    def run(moved: float) -> RunScore:
        rows = rng.normal(size=(4000, columns))
        theta = structure + moved * np.eye(columns)[4]
        information = rows.T @ rows
        return RunScore(information @ theta + rows.T @ rng.normal(size=4000), information)

    reference, test = [run(0.0) for _ in range(4)], [run(change) for _ in range(4)]
    found = contrast(test, reference, find_structure(reference, 2))
    size, std = found.size(np.array([4, 5])), np.sqrt(np.diag(found.covariance(np.array([4, 5]))))
    assert size == pytest.approx([change, 0.0], abs=0.05) and std.max() < 0.05


@pytest.mark.parametrize("own", [0.0, 0.05, 0.3])
def test_structure_of_each_run_widens_the_intervals_as_far_as_it_has_to(own: float) -> None:
    """Sizes of a change that is not there, over their standard deviations, over 40 pairs of sessions."""
    rng = np.random.default_rng(8)
    common, scores = rng.normal(size=30), []

    def run() -> RunScore:
        rows = rng.normal(size=(400, 30))
        information = rows.T @ rows
        return RunScore(information @ (common + own * rng.normal(size=30)) + rows.T @ rng.normal(size=400), information)

    for _ in range(40):
        reference, test = [run() for _ in range(4)], [run() for _ in range(4)]
        structure = find_structure(reference, 3)
        found = contrast(test, reference, structure)
        scores.append(found.size(np.array([9]))[0] / np.sqrt(found.covariance(np.array([9]))[0, 0]))
    assert 0.6 < np.std(scores) < 1.4
    assert structure.own == pytest.approx(own**2 * 400, rel=0.6, abs=0.5)


@cache
def records() -> tuple[Dataset, ...]:
    record = RECORDS["a0"]
    files = [REAL / record.folder / f"{r}.csv.gz" for r in record.runs]
    if not files[0].exists():
        pytest.skip("needs the real records beside the checkout")
    return prepare(files, load_rig(RIGS / record.rig)).setup.datasets


@pytest.mark.parametrize("fault", ["untouched", "torque_delay", "torque_saturation", "encoder_scale"])
def test_a_real_arm_says_what_was_put_into_its_test_runs(fault: str) -> None:
    record, every = RECORDS["a0"], records()
    test = [spoilt(d, fault) for d in every[1::2]]
    setup = prepare([*every[::2], *test], load_rig(RIGS / record.rig)).setup
    count = len(every[::2])
    found = detect_change(setup.datasets[count:], setup.datasets[:count], setup.mechanism, setup.options)
    if fault == "untouched":
        assert found.verdict == "no_change"
    else:
        assert fault in {c.effect for c in found.causes}


def spoilt(data: Dataset, fault: str) -> Dataset:
    if fault == "untouched":
        return data
    record = RECORDS["a0"]
    columns = {"time_s": data.time_s.copy(), **{k: v.copy() for k, v in data.columns.items()}}
    FAULTS[fault].put_in(columns, record, record.sizes[fault])
    del columns["time_s"]
    return replace(data, columns=columns)


