"""Choices that the paper leaves open in its simulation study: how the walker is driven, what is recorded, what is
replayed.

`OURS` poses the problem so that a right estimate leaves no error: the controller is sampled, its torque held for 10 ms,
and everybody is told so. `PRINTED` is the choice under which Table III comes out as printed
(docs/evidence/replication.md): a continuous controller whose torque is logged at 100 Hz, taken as samples of a smooth
function by every method, and replayed held. Even true parameters then leave 1.26 rad^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from studies.walker import BANDWIDTH, Step, one_step, one_step_continuous

TORQUE_VARIANCE = 0.1
"""sigma_u^2 of both motors by Table II [N^2 m^2]"""


@dataclass(frozen=True)
class Protocol:
    """One way to pose the study."""

    name: str
    continuous: bool
    """The controller acts at every instant; False: its torque is held from sample to sample."""
    bandwidth: float
    """Of the controller [rad/s]."""
    hold: str
    """How a fit takes the torque to act between samples."""
    torque_variance: float = TORQUE_VARIANCE
    """sigma_u^2 of both motors [N^2 m^2]"""
    passive_nm: float = 0.03
    """Standard deviation that stands for the stance foot's exact zero [N m]: a tenth of the motors' noise. MLE does not
    hinge on it (tests/studies/test_study.py); the paper's MLE, WLS with known weights and RLS do."""
    torque_filtered: bool = False
    """The torque is low-passed like the absolute angle, (34)."""
    spacing: Literal["n_cd", "half", "half up"] = "n_cd"
    """Of the differences (60), (61): n_cd of Table II, or, where that counts the samples spanned, half of it, rounded
    down or up."""
    first: int = 0
    """Sample of the step at which the record begins; 0: just after the impact."""

    def samples_apart(self, n_cd: int) -> int:
        """Spacing of the differences [samples]."""
        return {"n_cd": n_cd, "half": max(1, n_cd // 2), "half up": (n_cd + 1) // 2}[self.spacing]

    def step(self) -> Step:
        """The record without noise, in the angles that the motors turn."""
        return _step(self.continuous, self.bandwidth, self.first)


OURS = Protocol("ours", False, BANDWIDTH, "zero")
PRINTED = Protocol("printed", True, 6.0, "linear", passive_nm=0.1, spacing="half up")
PROTOCOLS = {protocol.name: protocol for protocol in (OURS, PRINTED)}


@lru_cache(maxsize=4)
def _step(continuous: bool, bandwidth: float, first: int) -> Step:
    if not continuous and bandwidth == BANDWIDTH and not first:
        return one_step().in_motor_angles()
    return one_step_continuous(bandwidth, continuous, first).in_motor_angles()
