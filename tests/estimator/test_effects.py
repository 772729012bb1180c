"""What an effect says of itself, and what it may not say."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import FitError
from estimator.effects import Perturbation, library
from estimator.effects.structure import EndStopContact
from estimator.model import chain


def test_a_reading_of_no_channel_is_refused_with_the_remedy() -> None:
    with pytest.raises(FitError, match=r"'gyro'.*torque_of\(joint\)"):
        Perturbation(readings={"gyro": np.zeros(3)})  # type: ignore[dict-item]


def test_every_signature_is_drawn_against_its_own_joint() -> None:
    """A ripple at joint 1 against joint 1, an offset of the torque against a joint that is driven."""
    m = chain(3, actuated=(0, 1))
    found = {e.key: e for e in library(m, False)[0]}
    assert found["torque_ripple@1"].shown_at(m) == 0 and found["torque_ripple@2"].shown_at(m) == 1
    assert found["torque_offset"].shown_at(m) == 1 and found["torque_offset"].depends_on == "v"


@pytest.mark.parametrize(("share", "is_stop"), [(0.42, False), (-0.75, True), (0.93, True), (-1.0, False)])
def test_a_stop_begins_in_the_outer_half_of_the_range_and_is_touched(share: float, is_stop: bool) -> None:
    """From 0.42 on it is a spring that hardens; at the very end the rounding of its law alone acts, a constant."""
    stop = EndStopContact(1)
    kept = stop.clipped(np.array([5.0, share]))
    assert stop.strict and bool(stop.at_limits(kept).any()) is not is_stop
    assert 0.49 < abs(kept[1]) < 1.0 and np.sign(kept[1]) == np.sign(share)
