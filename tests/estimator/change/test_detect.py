"""What changed on a leg of another engine, and on real records into which a fault is put exactly."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.random import Generator, default_rng
from pytest import approx, mark, param, raises, skip

from daq import Dataset, load_rig
from estimator import FitError, FitOptions
from estimator.change import Change, Reference, Structure, compare_sessions, detect_change, learn_reference
from estimator.change.contrast import Contrast, contrast, seen
from estimator.change.structure import STOP, find_structure
from estimator.change.verdict import replicates
from estimator.model import leg2
from estimator.score import Score, total
from evidence.blind.records import RECORDS, RIGS
from evidence.blind.servo import Readings
from evidence.blind.stickslip import MAKERS
from evidence.what_changed import runs_of, spoilt
from experiments.session import prepare
from experiments.workflows import find_change
from tests.support.changed_leg import REFERENCE, leg_runs, loaded
from tests.support.mujoco_leg import Leg
from tests.support.paths import REAL

SHORT_S = 6.0
"""Length of the runs where four of them tell the change."""


LEARNT: dict[str, Reference] = {}
"""What was learnt of reference runs, by the runs and how they are read: most tests have the same ones."""


def change_of(files: list[Path], rig_file: Path) -> Change:
    setup = prepare(files, load_rig(rig_file)).setup
    key = repr((setup.mechanism, setup.options, [file.read_bytes() for file in files[:REFERENCE]]))
    if key not in LEARNT:
        LEARNT[key] = learn_reference(setup.datasets[:REFERENCE], setup.mechanism, setup.options)
    return detect_change(setup.datasets[REFERENCE:], LEARNT[key])


def test_an_unchanged_leg_has_not_changed_and_says_what_it_would_have_shown(tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, lambda c: None, seconds=SHORT_S))
    assert found.verdict == "no_change" and not found.causes
    offset = next(d for d in found.detectable if d.effect == "encoder_offset")
    assert 0.0 < offset.size < 0.03


@mark.parametrize("name, size, kind", [
    ("encoder_offset", 0.03, "sensors"), ("gyro_scale", 0.03, "sensors"), ("torque_delay", 0.01, "timing"),
    ("sensor_time_skew", 0.005, "timing")])
def test_a_changed_reading_is_named_with_its_size(name: str, size: float, kind: str, tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, MAKERS[name][0](1.0), seconds=SHORT_S))
    cause = next(c for c in found.causes if c.effect == name)
    assert found.verdict in ("named", "partial", "one_of") and cause.kind == kind
    assert cause.size[0].value == approx(size, rel=0.25)
    assert sum(found.held_out.gain) > 0.0


def test_an_encoder_whose_zero_differs_from_run_to_run_shows_no_change_of_it(tmp_path: Path) -> None:
    files, rig_file = leg_runs(tmp_path, MAKERS["encoder_offset"][0](1.0), seconds=SHORT_S)
    setup = prepare(files, load_rig(rig_file)).setup
    found = {}
    for zeros in ((), (1,)):
        options = replace(setup.options, encoder_zeros=zeros)
        reference = learn_reference(setup.datasets[:REFERENCE], setup.mechanism, options)
        found[zeros] = detect_change(setup.datasets[REFERENCE:], reference)
    assert found[()].p_any < 1e-6 and "encoder_offset" in {c.effect for c in found[()].causes}
    assert found[1,].p_any > 0.01 and not found[1,].causes
    assert "encoder_offset" not in {d.effect for d in found[1,].detectable}


def sessions_of(files: list[Path], rig_file: Path) -> tuple[Change, Change]:
    """B from A, and A from B."""
    setup = prepare(files, load_rig(rig_file)).setup
    a, b = setup.datasets[:REFERENCE], setup.datasets[REFERENCE:]
    return (compare_sessions(a, b, setup.mechanism, setup.options),
            compare_sessions(b, a, setup.mechanism, setup.options))


@mark.parametrize("name, size, kind", [("", 0.0, ""), ("sensor_time_skew", 0.005, "timing")])
def test_two_sessions_exchanged_turn_the_signs_and_nothing_else(name: str, size: float, kind: str, tmp_path: Path
                                                                ) -> None:
    found, turned = sessions_of(*leg_runs(tmp_path, MAKERS[name][0](1.0) if name else lambda c: None,
                                          seconds=SHORT_S))
    # standard deviations as exact as the search for them ends, and with them the sizes and their intervals
    assert (found.verdict, found.structure) == (turned.verdict, approx(turned.structure, rel=STOP))
    assert [(c.effect, c.joint) for c in found.causes] == [(c.effect, c.joint) for c in turned.causes]
    for one, other in zip(found.causes, turned.causes):
        for there, back in zip(one.size, other.size, strict=True):
            low, high = back.ci95
            near = STOP * (high - low)
            assert there.value == approx(-back.value, abs=near)
            assert there.ci95 == approx((-high, -low), abs=near)
    if not name:
        assert found.verdict == "no_change" and "No difference" in found.sentence
        return
    cause = next(c for c in found.causes if c.effect == name)
    assert cause.kind == kind and cause.size[0].value == approx(size, rel=0.25)
    assert len(found.held_out.runs) == 8


def test_noise_alone_is_a_cause_with_its_ratio(tmp_path: Path) -> None:
    rng = default_rng(5)

    def noisier(c: Readings) -> None:
        c["gyro_radps"] += rng.normal(scale=0.007, size=c["gyro_radps"].size)  # 0.004 without it

    found, turned = sessions_of(*leg_runs(tmp_path, noisier))
    (cause,), (other,) = found.causes, turned.causes
    assert found.verdict == "named" and (cause.kind, cause.size[0].name) == ("noise", "gyro_radps")
    low, high = cause.size[0].ci95
    assert low < (0.004**2 + 0.007**2) ** 0.5 / 0.004 < high < 3.0
    assert other.size[0].value == approx(1.0 / cause.size[0].value)


@mark.parametrize("link, mass, distance", [
    (1, 0.03, 0.25), (2, 0.15, 0.1), *(param(*rest, marks=mark.slow)
                                       for rest in ((1, 0.2, 0.1), (2, 0.02, 0.2)))])
def test_a_payload_is_named_with_what_is_determined_of_it(link: int, mass: float, distance: float, tmp_path: Path
                                                          ) -> None:
    """From 2 to 20 % of the link's mass. Of the first link its own mass moves no parameter."""
    inertia = mass * 0.02**2
    found = change_of(*leg_runs(tmp_path, lambda c: None, lambda leg: loaded(leg, link, mass, distance, inertia),
                                seconds=SHORT_S))
    cause = found.causes[0]
    assert (found.verdict, cause.effect, cause.joint, cause.kind) == ("named", "payload", link, "parameters")
    true = {"mass": mass, "first_moment": mass * distance, "inertia": mass * distance**2 + inertia,
            "distance": distance, "farthest": distance + inertia / (mass * distance)}
    names = ["first_moment", "inertia", "farthest"] if link == 1 else ["mass", "first_moment", "inertia", "distance"]
    assert [s.name for s in cause.size] == names
    for size in cause.size:  # 95 % intervals, of which four legs have fourteen: one and a half times as wide
        low, high = size.ci95
        assert 1.25 * low - 0.25 * high < true[size.name] < 1.25 * high - 0.25 * low, size
        assert high - low < 0.3 * true[size.name]


def test_links_of_other_lengths_are_named_with_every_rigid_parameter(tmp_path: Path) -> None:
    """A longer first link with the same centre of mass: no body that is added does this."""
    legs: list[Leg] = []

    def longer(leg: Leg) -> Leg:
        other = replace(leg, l1=1.15 * leg.l1, c2=0.9 * leg.c2, m2=0.95 * leg.m2)
        legs[:] = [leg, other]
        return other

    found = change_of(*leg_runs(tmp_path, lambda c: None, longer, seconds=SHORT_S))
    cause = found.causes[0]
    assert (found.verdict, cause.effect, cause.joint, cause.kind) == ("named", "links", None, "parameters")
    before, after = (leg.beta() for leg in legs)
    for k, size in enumerate(cause.size):
        low, high = size.ci95
        true = after[k] - before[k]
        assert size.name == f"beta{k + 1}" and 1.25 * low - 0.25 * high < true < 1.25 * high - 0.25 * low


def test_a_body_that_is_taken_away_is_said_to_be(tmp_path: Path) -> None:
    found = change_of(*leg_runs(tmp_path, lambda c: None, lambda leg: loaded(leg, 2, -0.1, 0.12, -0.1 * 0.02**2),
                                seconds=SHORT_S))
    assert found.causes[0].sentence == "a body was taken from link 2"
    assert found.causes[0].size[0].value == approx(-0.1, rel=0.05)


def test_one_run_is_refused_with_a_remedy() -> None:
    time = np.linspace(0.0, 1.99, 200)
    data = Dataset("one", 100.0, time, {})
    with raises(FitError, match="give at least 2 of each session"):
        learn_reference([data], leg2(), FitOptions())
    found = compare_sessions([data], [data, data], leg2(), FitOptions())
    assert found.verdict == "fit_failed" and "give at least 2 of each session" in found.sentence


def scored(rng: Generator, rows: np.ndarray, theta: np.ndarray) -> Score:
    """A run of white noise."""
    return Score(rows.T @ (rows @ theta + rng.normal(size=len(rows))), rows.T @ rows)


def sessions(run: Callable[[float], Score], count: int) -> tuple[Contrast, Structure]:
    """A session of runs (1.0) from one of runs (0.0), and the structure of the latter."""
    reference, test = [run(0.0) for _ in range(4)], [run(1.0) for _ in range(4)]
    structure = find_structure([reference], count)
    return contrast(total(seen(test, structure)), total(seen(reference, structure)), structure), structure


def test_a_contrast_recovers_a_change_with_structure_in_the_reference() -> None:
    """Structure that both sessions have cancels; a change of one column comes back, of white noise's scatter."""
    rng, columns = default_rng(3), np.eye(6)
    structure = rng.normal(size=6)
    found = sessions(lambda moved: scored(rng, rng.normal(size=(4000, 6)), structure + 0.5 * moved * columns[4]),
                     2)[0].along(columns[:, 4:6])
    size, std = found.size(), np.sqrt(np.diag(found.covariance()))
    assert size == approx([0.5, 0.0], abs=0.05) and std.max() < 0.05


@mark.parametrize("own", [0.0, 0.05, 0.3])
def test_structure_of_each_run_widens_the_intervals_as_far_as_it_has_to(own: float) -> None:
    """Sizes of a change that is not there, over their standard deviations, over 40 pairs of sessions."""
    rng = default_rng(8)
    common, scores = rng.normal(size=30), []
    for _ in range(40):
        one, structure = sessions(
            lambda _: scored(rng, rng.normal(size=(400, 30)), common + own * rng.normal(size=30)), 3)
        found = one.along(np.eye(30)[:, 9:10])
        scores.append(found.size()[0] / np.sqrt(found.covariance()[0, 0]))
    assert 0.6 < np.std(scores) < 1.4
    assert structure.own == approx(own**2 * 400, rel=0.6, abs=0.5)


def test_a_level_that_all_runs_have_is_no_part_of_a_change() -> None:
    """One column of thirty has six standard deviations of one run in both sessions, such as an unmodelled delay."""
    rng = default_rng(5)
    here = np.eye(30)[:, 9:10]
    sizes, held = [], []
    for _ in range(60):
        found, _ = sessions(lambda _: scored(rng, rng.normal(size=(100, 30)), 0.6 * here[:, 0]), 3)
        one = found.measured(here, here[:, :0])
        sizes.append(one.size()[0])
        held.append(abs(sizes[-1]) < 2.0 * np.sqrt(one.covariance()[0, 0]))
    assert abs(np.mean(sizes)) < 0.03 and np.mean(held) > 0.88


def test_the_size_of_one_change_is_that_with_the_other_fitted() -> None:
    """Two columns that overlap changed; each size alone would take a part of the other."""
    rng, columns = default_rng(6), np.eye(6)

    def run(moved: float) -> Score:
        rows = rng.normal(size=(4000, 6))
        rows[:, 5] += rows[:, 4]
        return scored(rng, rows, moved * (0.3 * columns[4] + 0.2 * columns[5]))

    found, _ = sessions(run, 2)
    assert found.measured(columns[:, 4:5], columns[:, 5:6]).size() == approx([0.3], abs=0.05)
    assert found.measured(columns[:, 4:5], columns[:, :0]).size()[0] > 0.4


@cache
def records() -> tuple[Dataset, ...]:
    record = RECORDS["a0"]
    files = [REAL / record.folder / f"{r}.csv.gz" for r in record.runs]
    if not files[0].exists():
        skip("needs the real records next to the checkout")
    return prepare(files, load_rig(RIGS / record.rig)).setup.datasets


@mark.parametrize("fault", ["untouched", "torque_delay", "torque_saturation", "encoder_scale"])
def test_a_real_arm_says_what_was_put_into_its_test_runs(fault: str) -> None:
    record, every = RECORDS["a0"], records()
    count = 3
    test = spoilt(every[count:], "a0", fault, record.sizes.get(fault, 0.0))
    setup = prepare([*every[:count], *test], load_rig(RIGS / record.rig)).setup
    found = detect_change(setup.datasets[count:],
                          learn_reference(setup.datasets[:count], setup.mechanism, setup.options))
    if fault == "untouched":
        assert found.verdict == "no_change"
    else:
        assert fault in {c.effect for c in found.causes}


def test_a_predicted_gain_is_the_ratio_of_the_predictive_densities() -> None:
    """Against normal densities of the readings: mean A d and covariance 1 + A C A^T, and mean 0 and covariance 1."""
    from scipy.stats import multivariate_normal

    rng = default_rng(4)
    own, other = rng.normal(size=(5, 2)), rng.normal(size=(30, 2))
    size = np.array([0.7, -0.4])
    y, z = own @ size + rng.normal(size=5), other @ size + rng.normal(size=30)
    known = np.linalg.inv(other.T @ other)
    wanted = 2.0 * (multivariate_normal(own @ known @ other.T @ z, np.eye(5) + own @ known @ own.T).logpdf(y)
                    - multivariate_normal(np.zeros(5), np.eye(5)).logpdf(y))
    found = Score(own.T @ y, own.T @ own).predicted_gain(Score(other.T @ z, other.T @ other))
    assert found == approx(wanted, rel=1e-4)


def test_a_run_that_cannot_tell_has_no_vote_and_one_that_contradicts_has() -> None:
    assert replicates([-0.8, 90.0]) and replicates([2.0, 3.0])
    assert not replicates([-20.0, 90.0]) and not replicates([-2.0, 1.0])


@mark.skipif(not (REAL / "dfki_c0").exists(), reason="needs the real records next to the checkout")
def test_each_motor_of_an_arm_saturates_on_its_own() -> None:
    reference = (1, 2, 3, 6)
    runs = runs_of("c0")
    test = spoilt([run for k, run in enumerate(runs) if k not in reference], "c0", "torque_saturation", 0.6)
    found = find_change(test, [runs[k] for k in reference], load_rig(RIGS / RECORDS["c0"].rig)).change
    assert {(c.effect, c.joint) for c in found.causes} == {("torque_saturation", 1), ("torque_saturation", 2)}
