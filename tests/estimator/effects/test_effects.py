"""What an effect says of itself, and what it may not say."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from daq import FloatArray
from estimator import FitError
from estimator.effects import Perturbation, Points, View, library
from estimator.effects.directional_load_friction import DirectionalLoadFriction
from estimator.effects.end_stop_contact import EndStopContact
from estimator.effects.generic_terms import READINGS
from estimator.model import ImuPlace, chain, joint1, leg2, smooth_sign


def test_a_reading_of_no_channel_is_refused_with_the_remedy() -> None:
    with pytest.raises(FitError, match=r"'gyro'.*torque_of\(joint\)"):
        Perturbation(readings={"gyro": np.zeros(3)})  # type: ignore[dict-item]


def test_every_signature_is_drawn_against_its_own_joint() -> None:
    """A ripple at joint 1 against joint 1, an offset of each motor's torque against that motor's joint."""
    m = chain(3, actuated=(0, 1))
    found = {e.key: e for e in library(m, False)[0]}
    assert found["torque_ripple@1"].shown_at(m) == 0 and found["torque_ripple@2"].shown_at(m) == 1
    assert found["torque_offset@2"].shown_at(m) == 1 and found["torque_offset@2"].depends_on == "v"


def test_each_of_several_motors_has_its_own_shunt_and_the_only_one_has_no_joint() -> None:
    several, one = ({e.key for e in library(chain(3, actuated=driven), False)[0]} for driven in ((0, 2), (1,)))
    for name in ("torque_offset", "torque_saturation"):
        assert {key for key in several if key.startswith(name)} == {f"{name}@1", f"{name}@3"}
        assert {key for key in one if key.startswith(name)} == {name}
    assert "torque_delay" in several & one


def test_a_load_on_a_gear_is_that_of_the_links_without_a_body_on_top() -> None:
    """A body that a simulation moves, too, has a row of its own: a diagnosis ended in a shape mismatch."""
    m = joint1()
    beta, size = np.array([0.1, 0.5, 0.0, 0.0]), np.array([0.1, 0.0, 1.0, 0.3])

    def torque(rows: int) -> FloatArray:
        still = np.zeros((rows, 2, 3))
        at = Points(still + 0.4, still, still, still, still + 1.0, still[0], still[0], still[0])
        view = View(m, beta, at, at, np.arange(3), (0.2, 0.8), np.zeros(1, dtype=np.intp), 0.01, np.ones(rows))
        return DirectionalLoadFriction(0).law(at, size, view)

    assert_allclose(torque(2), torque(1))
    assert_allclose(torque(1), 0.1 * 0.5 * 9.81 * np.sin(0.4), rtol=1e-3)


def test_an_encoder_that_is_not_read_has_no_effect() -> None:
    """A leg with two IMUs and no encoder, and one with its knee's."""
    m = leg2().with_imus((ImuPlace(0, 0.2), ImuPlace(1, 0.1)), (0.3,))
    for encoders in ((), (1,)):
        effects, refused = library(m, True, encoders)
        found = {e.key for e in effects}
        for kind in ("encoder_offset", "encoder_scale", "encoder_eccentricity"):
            assert (f"{kind}@2" in found) == (1 in encoders) == (f"{kind}@2" not in refused)
            assert "encoder" in refused[f"{kind}@1"]
        for kind in ("joint_elasticity", "backlash"):
            assert (f"{kind}@2" in found) == (1 in encoders) == (f"{kind}@2" not in refused)


@pytest.mark.parametrize("share, is_stop", [(0.42, False), (-0.75, True), (0.93, True), (-1.0, False)])
def test_a_stop_begins_in_the_outer_half_of_the_range_and_is_touched(share: float, is_stop: bool) -> None:
    """From 0.42 on it is a spring that hardens; at the very end the rounding of its law alone acts, a constant."""
    stop = EndStopContact(1)
    kept = stop.clipped(np.array([5.0, share]))
    assert stop.strict and bool(stop.at_limits(kept).any()) is not is_stop
    assert 0.49 < abs(kept[1]) < 1.0 and np.sign(kept[1]) == np.sign(share)


@pytest.mark.parametrize("bent, own", [
    (lambda w: np.clip(w, -0.1, 0.1), "v"), (lambda w: 0.02 * w**3, "v"),
    (lambda q: 0.05 * np.abs(q - 0.2), "q"), (lambda q: 0.03 * q**3, "q")], ids=["dead band", "soft", "kink", "cubic"])
def test_terms_without_a_name_follow_a_sensors_bent_curve(bent: Callable[[FloatArray], FloatArray], own: str) -> None:
    """Of what scale and offset, which have names, leave of it they take half at least. (A gyro's dead band was named
    for its scale.)"""
    time, rng = np.arange(4000) / 100.0, np.random.default_rng(4)
    phase, w = rng.uniform(0.0, 6.0, (2, 3, 1)), 2.0 * np.pi * np.array([[0.3], [0.7], [1.1]])
    q = np.stack([(0.3 * np.sin(w * time + p)).sum(axis=0) for p in phase])
    v, a = (np.gradient(x, 0.01, axis=1) for x in (q, np.gradient(q, 0.01, axis=1)))
    view = SimpleNamespace(samples=SimpleNamespace(q=q, v=v, a=a, u=a, sign=smooth_sign(v, 0.05), time_s=time))
    sensed = v[0] if own == "v" else q[1]
    off, named = bent(sensed), np.column_stack([np.ones_like(sensed), sensed])
    every = np.column_stack([named, *(law(view) for law in READINGS.values())])  # type: ignore[arg-type]
    left, still = (off - columns @ np.linalg.lstsq(columns, off)[0] for columns in (named, every))
    assert np.std(still) < 0.5 * np.std(left)
