"""Which explanations of one gap are called a tie, and which are none: their effect is nil, or has the wrong sign."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from pytest import mark

from daq import FloatArray
from estimator import Effect
from estimator.diagnosis.explanation import Explanation, indistinguishable_set, presence, undetermined
from estimator.effects.asymmetric_friction import AsymmetricFriction
from estimator.effects.encoder_eccentricity import EncoderEccentricity
from estimator.effects.encoder_scale import EncoderScale
from estimator.effects.joint_elasticity import JointElasticity
from estimator.effects.joint_stiffness import JointStiffness
from estimator.effects.quadratic_drag import QuadraticDrag
from estimator.effects.rotor_inertia import RotorInertia
from estimator.effects.torque_offset import TorqueOffset
from tests.support.stated_fits import explained

TESTS = 150
"""Candidates that were tried: a size counts from four standard deviations on."""


def explanation(effect: Effect, gain: float, by_run: list[float], sizes: list[float] | None = None,
              has_residual: bool = False, inflation: float = 1.0) -> Explanation:
    """One effect with sizes in units of their standard deviations."""
    size = np.array(sizes or [20.0] * effect.count)
    model: Any = SimpleNamespace(effects=(effect,), named=(effect,), sizes=lambda: [size],
                                 std=lambda: np.ones(5 + effect.count), places=lambda: [slice(5, 5 + effect.count)],
                                 problem=SimpleNamespace(mechanism=SimpleNamespace(p=5)))
    left: Any = SimpleNamespace(scatter=1.0)
    return Explanation(model, gain, left, has_residual, np.array(by_run),
                       inflation=np.full(5 + effect.count, inflation), further=np.zeros(TESTS),
                       determined=np.ones(5 + effect.count, dtype=bool))


def names(ties: list[Explanation]) -> list[str]:
    return [e.model.effects[0].name for e in ties]


def test_runs_that_disagree_make_a_tie() -> None:
    scale = explanation(EncoderScale(1), 1546.0, [0.0] * 6)
    rotor = explanation(RotorInertia(1), 1504.0, [-75.0, 81.0, 60.0, -40.0, 55.0, -12.0])
    assert names(indistinguishable_set([rotor, scale])) == ["encoder_scale", "rotor_inertia"]


def test_two_fits_of_one_set_of_effects_are_compared_as_such() -> None:
    """Their arrays are not: that was an internal error."""
    @dataclass
    class Model:
        effects: tuple[Effect, ...]
        beta: FloatArray

        def __getattr__(self, name: str) -> Any:
            return getattr(like, name)

    offset = TorqueOffset()
    one, two = (explanation(offset, gain, [k, -k] * 3, [20.0]) for gain, k in ((1500.0, 0.0), (1499.0, 40.0)))
    like: Any = one.model
    fitted: Any = Model((offset,), np.ones(3))
    both = [replace(e, model=fitted) for e in (one, two)]
    assert len(indistinguishable_set(both)) == 2


@mark.parametrize(("gain", "by_run"), [
    (1504.0, [6.0, 7.0, 6.0, 7.0, 8.0, 8.0]),  # a small difference on which all runs agree
    (1300.0, [-9.0, 55.0, 40.0, 45.0, 110.0, 5.0]),  # a large one that one run is little against
])
def test_a_clear_second_is_no_tie(gain: float, by_run: list[float]) -> None:
    scale = explanation(EncoderScale(1), 1546.0, [0.0] * 6)
    assert names(indistinguishable_set([scale, explanation(RotorInertia(1), gain, by_run)])) == ["encoder_scale"]


@mark.parametrize(("scale", "rotor", "told"), [
    ([90.0, 5.0], [90.0, 5.0], ["encoder_scale"]),  # both leave it: it speaks for neither
    ([0.0, 5.0], [40.0, 5.0], ["encoder_scale"]),  # it only imitates the scale
    ([90.0, 5.0], [130.0, 5.0], ["encoder_scale", "rotor_inertia"]),  # with it in both the rotor is as likely
    ([90.0, 5.0], [120.0, 5.0], ["encoder_scale"]),  # ... but by 12
    ([30.0, 5.0], [130.0, 5.0], ["encoder_scale"])])  # it counts for what the scale leaves, 30
def test_what_both_leave_can_make_a_tie(scale: list[float], rotor: list[float], told: list[str]) -> None:
    """Gains of two further effects in addition to each of two explanations that are 42 apart on runs that agree."""
    likely, other = (replace(explanation(effect, gain, by_run), further=np.pad(gains, (0, TESTS - 2)))
                     for effect, gain, by_run, gains in ((EncoderScale(1), 1546.0, [0.0] * 6, scale),
                                                         (RotorInertia(1), 1504.0, [7.0] * 6, rotor)))
    assert names(indistinguishable_set([likely, other])) == told


@mark.parametrize(("left", "told"), [
    (140.0, ["torque_offset", "asymmetric_friction"]),  # more than the 43 between them: it decides nothing
    (30.0, ["torque_offset"])])
def test_what_both_leave_does_not_tell_effects_of_one_group_apart(left: float, told: list[str]) -> None:
    likely, other = (replace(explanation(effect, gain, by_run, sizes, has_residual=True),
                             further=np.full(TESTS, left))
                     for effect, gain, by_run, sizes in ((TorqueOffset(), 1546.0, [0.0] * 6, [20.0]),
                                                         (AsymmetricFriction(2), 1503.0, [7.0] * 6, [20.0, 0.5])))
    assert names(indistinguishable_set([likely, other])) == told


def constants(stiffness: float, viscous: float) -> list[Explanation]:
    """A constant torque told in three ways, with these sizes, in standard deviations, that set two of them apart."""
    return [explanation(JointStiffness(1), 1001.0, [0.0] * 6, [stiffness, 50.0]),
            explanation(TorqueOffset(), 1000.0, [1.0] * 6, has_residual=True),
            explanation(AsymmetricFriction(1), 999.0, [2.0] * 6, [50.0, viscous], has_residual=True)]


def test_a_spring_without_stiffness_is_an_offset() -> None:
    assert names(indistinguishable_set(constants(1.5, 0.5))) == ["torque_offset", "asymmetric_friction"]


def test_a_spring_with_stiffness_is_no_offset() -> None:
    assert names(indistinguishable_set(constants(9.0, 0.5))) == ["joint_stiffness"]


def test_a_stiffness_may_stand_for_what_the_model_lacks_besides() -> None:
    """A late torque of 1 ms looked like a stiffness, and the offset was named a spring."""
    lacking = [replace(one, has_residual=True, further=np.full(TESTS, 30.0)) for one in constants(9.0, 0.5)]
    assert len(indistinguishable_set(lacking)) == 3


def test_a_stiffness_that_scatters_between_runs_makes_no_spring() -> None:
    spring, *others = constants(5.0, 0.5)
    assert names(indistinguishable_set([spring, *others])) == ["joint_stiffness"]
    loose = explanation(JointStiffness(1), 1001.0, [0.0] * 6, [5.0, 50.0], inflation=2.0)
    assert names(indistinguishable_set([loose, *others])) == ["torque_offset", "asymmetric_friction"]


def test_a_preload_at_a_joint_without_motor_may_be_a_spring() -> None:
    told = names(indistinguishable_set([constants(1.5, 0.5)[0], constants(1.5, 0.5)[2]]))
    assert told == ["joint_stiffness", "asymmetric_friction"]


def test_what_leaves_nothing_stands_before_what_is_likelier() -> None:
    likely = explanation(EncoderScale(1), 1500.0, [0.0] * 6, has_residual=True)
    assert names(indistinguishable_set([likely, explanation(RotorInertia(1), 1498.0, [0.5] * 6)])) == ["rotor_inertia"]


@mark.parametrize(("effect", "sizes", "there"), [
    (EncoderScale(1), [-0.5], True), (EncoderScale(1), [-1.2], False),
    (EncoderEccentricity(1), [0.05, 0.05], True), (EncoderEccentricity(1), [0.84, 0.75], False)])
def test_a_reading_that_turns_back_is_no_error_of_an_encoder(effect: Effect, sizes: list[float], there: bool) -> None:
    assert effect.possible(np.array(sizes)) is there


@mark.parametrize(("effect", "sizes", "there"), [
    (QuadraticDrag(1), [9.0], True),
    (QuadraticDrag(1), [3.0], False),  # three standard deviations
    (QuadraticDrag(1), [-9.0], False),  # drag that drives
    (RotorInertia(1), [-9.0], False),
    (JointElasticity(1), [9.0, 0.0, 0.0, 0.0], True),
    (JointElasticity(1), [0.5, 30.0, 30.0, 30.0], False),  # its motor's friction and inertia alone
    (AsymmetricFriction(1), [0.0, -9.0], True),
    (JointStiffness(1), [9.0, 0.0], True),
    (JointStiffness(1), [-9.0, 9.0], False),  # a spring that pushes
    (JointStiffness(1), [-1.0, 9.0], True)])
def test_an_effect_is_there_by_the_sizes_that_define_it(effect: Effect, sizes: list[float], there: bool) -> None:
    assert presence(explanation(effect, 1000.0, [0.0] * 6, sizes)) == [there]


@mark.parametrize(("inflation", "known", "there"), [
    (1.0, (True, True), True), (1.0, (True, False), True), (1.0, (False, True), False), (4.0, (True, True), False)])
def test_a_size_counts_where_it_is_determined_and_beyond_its_scatter(inflation: float, known: tuple[bool, bool],
                                                                     there: bool) -> None:
    """A slide's spring: stiffness 5 standard deviations of white noise; another effect could replace its preload."""
    spring = explanation(JointStiffness(0), 1000.0, [0.0] * 6, [5.0, 1.0], inflation=inflation)
    spring.determined[5:] = known
    assert presence(spring) == [there] and undetermined(spring) == [known == (False, False)]


@mark.parametrize(("halves", "kept"), [((8.0, 8.0), ("spring", "offset")), ((10.0, 8.0), ("offset",)),
                                              ((10.0, 10.0), ())])
def test_a_size_that_the_tolerances_do_not_tell_from_zero_is_no_fault(halves: tuple[float, float],
                                                                     kept: tuple[str, ...]) -> None:
    one = explained(900.0, "spring", "offset")  # both of size 9
    vars(one).update(half_widths=np.array(halves), estimate=(np.array([9.0, 9.0]), np.eye(2)))
    assert one.as_told().beyond == set(kept)
