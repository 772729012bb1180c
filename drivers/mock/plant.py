"""The physics under an emulated rig is handed in; here is only what it must look like."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class JointState(Protocol):
    """Joint state [rad, rad/s, rad/s2], signs as in the CSV contract.

    It may also have `q2_motor`, the knee motor's angle divided by the gear ratio [rad], where that differs from
    `q2` (elastic or loose gears): the knee encoder sits there.
    """

    @property
    def q1(self) -> float: ...
    @property
    def q2(self) -> float: ...
    @property
    def q1d(self) -> float: ...
    @property
    def q2d(self) -> float: ...
    @property
    def q1dd(self) -> float: ...


class Plant(Protocol):
    """Physics advanced in small steps."""

    def step(self, dt_s: float, torque_nm: float) -> JointState:
        """State after `dt_s` [s] with this mean joint torque at the knee [N m]."""


class Snapshot(NamedTuple):
    """A state copied out of the plant, which may reuse its own; by default a leg that hangs still."""

    q1: float = 0.0
    q2: float = 0.0
    q1d: float = 0.0
    q2d: float = 0.0
    q1dd: float = 0.0
    q2_motor: float = 0.0


def snapshot(state: JointState) -> Snapshot:
    """Copy of the plant's state."""
    return Snapshot(float(state.q1), float(state.q2), float(state.q1d), float(state.q2d), float(state.q1dd),
                    float(getattr(state, "q2_motor", state.q2)))


class Segment(NamedTuple):
    """One physics step: the states at its two ends."""

    t0_ns: int
    t1_ns: int
    before: Snapshot
    after: Snapshot

    def at(self, t_ns: float) -> Snapshot:
        """State in between, linearly interpolated."""
        w = (t_ns - self.t0_ns) / (self.t1_ns - self.t0_ns)
        return Snapshot(*[a + w * (b - a) for a, b in zip(self.before, self.after)])
