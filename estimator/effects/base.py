"""`Effect`: one thing a simulation of the rig can get wrong, with its physics, sizes and plain sentence.

An effect says what it adds to the model at a motion: a torque that the motion needs beyond Z beta, or an
amount added to a sensor's reading. Scoring (derivative at zero size), re-fit (derivative at its size) and
simulation all call the same `perturb`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np

from daq import BoolArray, FloatArray, IndexArray
from estimator.effects.commanded import Commanded
from estimator.errors import FitError
from estimator.model import Mechanism
from estimator.signals import Channel, shifted

WHEEL_M = 0.05
"""A slide's shapes are those of a joint that drives it by a wheel of this radius: grids of rad times this, in m."""
CONSTANT = "constant torque"
"""`Effect.equivalence_class`: a constant torque on a joint that slides, shared out between two directions of friction,
a preload or an offset. They differ near rest only, where no friction law is exact."""

Axis = Literal["q", "v", "a", "u", "du", "turn", "session"]
"""Angle, rate and acceleration of a joint, what the motor gives, its rate, the motor's angle within a turn, time."""
PlanKind = Literal["large", "small", "ramps", "swing", "slow", "steady", "fast", "micro", "rest"]
"""Kinds of torque plan that a session is made of; experiments make them."""


class Size(NamedTuple):
    """One parameter of an effect."""

    name: str
    unit: str
    scale: float
    """A small size of the effect: the step of its derivative at zero."""
    prior: float = np.inf
    """Standard deviation of its wide prior: without it a size that a nominal parameter imitates diverges."""
    tolerance: float = 0.0
    """Standard deviation of the size on a rig that nobody has looked at, SI; where the unit has a torque, for a rig
    whose torques reach 1 N m. Zero: the budget of a fit leaves it out."""


class Shape(NamedTuple):
    """A parameter that only means something once the size is not zero; scored on a grid."""

    name: str
    unit: str
    grid: tuple[float, ...]
    above: float = 4.0
    """Factor by which a fit may exceed the grid's largest value"""
    below: float = 4.0
    """Factor by which a fit may fall below its smallest one"""
    discrete: bool = False
    """Held at values of the grid, the likeliest one; not re-fitted."""
    default: float | None = None
    """Value in a model file that does not state it."""


@dataclass(frozen=True)
class Points:
    """Motion at a set of instants; arrays (n, ...) by joint, or (...) by instant."""

    q: FloatArray
    v: FloatArray
    a: FloatArray
    u: FloatArray
    """True motor torque [N m]."""
    sign: FloatArray
    """Smoothed sign of v (n, ...), averaged over the half interval at Gauss points."""
    time_s: FloatArray
    """Since the start of the run."""
    session_s: FloatArray
    """Since the start of the first run, pauses left out."""
    run: FloatArray
    """Number of the run, 0, 1, ..."""
    exchanged: FloatArray | float = 0.0
    """1 where a walker's leg 2 stands, see `Mechanism.exchanged`."""
    state: FloatArray | float = 0.0
    """(...) of a `StateEffect`."""
    commanded: Commanded | None = None
    """What position loops are told; None where no joint has one."""


@dataclass(frozen=True)
class Record:
    """Readings of the sensors, each array (N,)."""

    readings: Mapping[Channel, FloatArray]
    slow: Mapping[Channel, FloatArray]
    """The gyro low-passed above any motion of a leg's links, torques to what a spline follows."""
    rate: Mapping[int, FloatArray]
    """Of each joint with an encoder, what it read differenced once"""
    acceleration: Mapping[int, FloatArray]
    """The same differenced twice"""


@dataclass(frozen=True)
class View:
    """Input of an effect: the motion, the parameters, the rig."""

    mechanism: Mechanism
    beta: FloatArray
    gauss: Points
    samples: Points
    left: IndexArray
    weights: tuple[float, float]
    """Fractions of an interval at which its Gauss points lie."""
    starts: IndexArray
    """First sample of each gap-free segment."""
    dt_s: float
    angle_range: FloatArray
    """(n, 2) smallest and largest angle over all runs."""
    gear_ratio: float = 1.0
    measured: Record | None = None
    """None in a simulation."""

    def parameter(self, term: str, joint: int) -> float:
        """The nominal parameter of this term at this joint; zero where the model has none."""
        return float(sum(b for b, p in zip(self.beta, self.mechanism.parameters) if (p.term, p.at) == (term, (joint,))))

    def to_gauss(self, x: FloatArray) -> FloatArray:
        """Values (..., N) at samples to (..., 2, K), linear between samples."""
        a, b = x[..., self.left], x[..., self.left + 1]
        return np.stack([(1.0 - w) * a + w * b for w in self.weights], axis=-2)

    def delayed(self, true: FloatArray, recorded: FloatArray | None, delay_s: float) -> FloatArray:
        """(N,) what a delay d adds to a sensor's reading at the samples: x(t - d) - x(t), x the `true` quantity (N,).

        Where the sensor has `recorded` y (N,), it is y(t) - y(t + d): the residual then is x(t) - y(t + d), whose
        dependence on x is plain, instead of x(t - d) - y(t).
        """
        return self.shifted(true, delay_s) - true if recorded is None else recorded - self.shifted(recorded, -delay_s)

    def shifted(self, x: FloatArray, delay_s: float) -> FloatArray:
        """x(t - delay) at the samples (N,), cubic spline within each segment, its ends held."""
        out = np.empty_like(x)
        for where in self.segments():
            out[where] = shifted(x[where], delay_s / self.dt_s)
        return out

    def segments(self) -> list[slice]:
        """Gap-free segments of samples."""
        stops = np.append(self.starts[1:], self.samples.q.shape[-1])
        return [slice(int(a), int(b)) for a, b in zip(self.starts, stops)]


@dataclass(frozen=True)
class Perturbation:
    """Contribution of one effect; None where it adds nothing."""

    torque: FloatArray | None = None
    """(n, 2, K) [N m]"""
    torque_at_samples: FloatArray | None = None
    """(n, N)"""
    readings: Mapping[Channel, FloatArray] = field(default_factory=dict)
    """What is added to each, (N,)."""

    def __post_init__(self) -> None:
        for channel in self.readings:
            if not isinstance(channel, Channel):  # an effect of someone's own: it would add to nothing
                raise FitError(f"an effect adds to the reading of {channel!r}, which is no Channel: take GYRO, "
                               "ACCEL_X, ACCEL_Y, torque_of(joint) or encoder_of(joint) of estimator.signals")


class Joined(Protocol):
    """An object with a law at a joint."""

    joint: int | None

    def felt(self, count: int) -> Iterable[int]:
        """Joints of `count` whose motion its law depends on."""

    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        """(...) torque on the joint [N m]."""


class Effect(ABC):
    """Base of all effects; `size` vectors hold the sizes first, then the shapes."""

    name: ClassVar[str]
    sizes: ClassVar[tuple[Size, ...]]
    shapes: tuple[Shape, ...] = ()
    loop_shapes: ClassVar[tuple[Shape, ...]] = ()
    """Further ones of an effect at a joint whose torque the law of a position loop gives."""
    sentence: ClassVar[str]
    """What it means, for a person."""
    reference: ClassVar[str]
    tolerance_source: ClassVar[str] = ""
    """Where the tolerances of its sizes come from."""
    experiment: ClassVar[str]
    """What run would show it best."""
    depends_on: ClassVar[Axis] = "q"
    """Against what its signature is drawn."""
    plans: ClassVar[tuple[PlanKind, ...] | None] = None
    """Kinds of plan that show it, in addition to `large` and `small` of every session; None where none is known."""
    by_hand: ClassVar[str] = ""
    """What shows it that no torque plan can do."""
    per_joint: ClassVar[bool] = False
    per_loop: ClassVar[bool] = False
    """Whether only joints that follow a command have it."""
    per_motor: ClassVar[bool] = False
    """Whether each of several motors has its own size; the only motor of a rig has no joint."""
    equivalence_class: ClassVar[str] = ""
    """Effects of one such group cannot be told apart by small differences: these stem from what no model has right."""
    distinguishing_size: ClassVar[int | None] = None
    """Which size sets an effect apart from its group: without it, it is the same function of the motion."""
    positive: ClassVar[int] = 0
    """Its first so many sizes are not below zero where the effect is present: friction that drives is none."""
    defining: ClassVar[int | None] = None
    """One of the first so many sizes is not zero where the effect is present; by default, of all."""
    strict: ClassVar[bool] = False
    """True if a shape parameter at a limit of its range makes it another effect than its name says."""
    driven_only: ClassVar[str] = ""
    """Why a joint without a motor cannot have it; empty where it can."""
    starts: ClassVar[tuple[tuple[float, ...], ...]] = ()
    """Sizes from which a fit begins, too: slopes at zero say little of large ones."""

    def __init__(self, joint: int | None = None, slide: bool = False) -> None:
        self.joint = joint
        """0-based; None for effects of the whole rig."""
        self.slide = slide
        """Whether its joint is prismatic; see `WHEEL_M`."""

    @property
    def key(self) -> str:
        """Name, and the joint (1-based) where there is one."""
        return self.name if self.joint is None else f"{self.name}@{self.joint_number}"

    @property
    def joint_number(self) -> int | None:
        """Its joint as people count them, from 1; None of the whole rig."""
        return None if self.joint is None else self.joint + 1

    def shown_at(self, mechanism: Mechanism) -> int:
        """The joint whose motion its signature is drawn against."""
        return self.joint or 0

    @property
    def count(self) -> int:
        """Number of sizes and shapes."""
        return len(self.sizes) + len(self.shapes)

    def possible(self, size: FloatArray) -> bool:
        """Whether a device can have these sizes (count,), their signs apart."""
        return True

    def meaning(self, shape: tuple[float, ...]) -> str:
        """`sentence`, at these values of its shapes."""
        return self.sentence

    def told(self, size: FloatArray) -> str:
        """`meaning` with what the signs of the sizes (count,) say, in words."""
        return self.meaning(tuple(size[len(self.sizes) :]))

    @property
    def usual(self) -> tuple[float, ...] | None:
        """Defaults of its shapes; None where a shape has none, so that sizes alone do not define the effect."""
        found = tuple(shape.default for shape in self.shapes if shape.default is not None)
        return found if len(found) == len(self.shapes) else None

    def tried(self, shape: Shape) -> tuple[float, ...]:
        """The shape's grid, in the unit that its joint moves in."""
        factor = WHEEL_M if self.slide and shape.unit.startswith("rad") else 1.0
        return tuple(factor * value for value in shape.grid)

    def grid(self) -> list[tuple[float, ...]]:
        """All combinations of shapes that scoring tries."""
        return list(product(*map(self.tried, self.shapes)))

    def clipped(self, size: FloatArray) -> FloatArray:
        """`size` with its shapes kept near the range of their grids (`Shape`), on their side of zero."""
        out = np.array(size, dtype=np.float64)
        for i, shape in enumerate(self.shapes, len(self.sizes)):
            side = np.sign(out[i]) if min(shape.grid) < 0 else 1.0
            out[i] = side * np.clip(side * out[i], *self._range(shape))
        return out

    def at_limits(self, size: FloatArray) -> BoolArray:
        """For each shape, whether it is at a limit of its range: what the data would have there is not to be had."""
        limits = [self._range(shape) for shape in self.shapes]
        return np.array([not shape.discrete and (abs(s) <= low or abs(s) >= high)
                         for shape, s, (low, high) in zip(self.shapes, size[len(self.sizes) :], limits)], dtype=bool)

    def _range(self, shape: Shape) -> tuple[float, float]:
        magnitudes = np.abs(self.tried(shape))
        return float(magnitudes.min() / shape.below), float(magnitudes.max() * shape.above)

    @abstractmethod
    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        """Its contribution at `size` (count,) to the motion in `view`."""

    def about(self, size: FloatArray) -> Self:
        """The effect whose differences near `size` (count,) are its derivatives: one without its jumps."""
        return self

    def by_torque(self, view: View, size: FloatArray) -> Mapping[Channel, FloatArray]:
        """Encoder or torque channel to derivative (N,) of what it adds by its joint's torque latent; else lagged."""
        return {}

    def testable(self, mechanism: Mechanism, has_imu: bool, actuated: tuple[int, ...]) -> str:
        """Why it cannot be tested on this rig; empty where it can."""
        return "" if self.joint in actuated else self.driven_only


class LawEffect(Effect):
    """Its torque in a simulation is `law` alone: a function of the motion, and of its state, at an instant."""

    per_joint = True

    @abstractmethod
    def law(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        """(...) torque on its own joint [N m]."""

    @property
    def parts(self) -> tuple[Joined, ...]:
        """Terms whose sum is its law, joint by joint."""
        return (self,)

    @property
    def has_state(self) -> bool:
        """Whether its law has a state in a simulation."""
        return isinstance(self, StateEffect) and self.parts == (self,)

    def felt(self, count: int) -> Iterable[int]:
        """Joints of `count` whose motion its law depends on."""
        return (self.joint or 0,)


class TorqueEffect(LawEffect):
    """A torque that depends on the motion at the same instant."""

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        return Perturbation(self._placed(view.gauss, size, view), self._placed(view.samples, size, view))

    def _placed(self, at: Points, size: FloatArray, view: View) -> FloatArray:
        out = np.zeros_like(at.q)
        out[self.joint or 0] = self.law(at, size, view)
        return out


class StateEffect(LawEffect):
    """A torque by the motion and one state z, which begins as sign(v) and forgets: z[k+1] = e z[k] + (1 - e) target.

    The state is linear between samples.
    """

    @abstractmethod
    def relaxation(self, v: tuple[FloatArray, FloatArray], sign: tuple[FloatArray, FloatArray], size: FloatArray,
                   dt_s: float) -> tuple[FloatArray, FloatArray]:
        """(e, target) over intervals, by rate and smoothed sign (...) at both ends."""

    def states(self, v: FloatArray, sign: FloatArray, starts: IndexArray, size: FloatArray, dt_s: float) -> FloatArray:
        """z (N,) along the rates v (N,) of segments that begin at samples `starts`: one bidiagonal solve."""
        from scipy.linalg import solve_banded

        decay, target = self.relaxation((v[:-1], v[1:]), (sign[:-1], sign[1:]), size, dt_s)
        decay[starts[1:] - 1] = 0.0
        right = np.concatenate([sign[:1], (1.0 - decay) * target])
        right[starts] = sign[starts]
        band = np.ones((2, v.shape[0]))
        band[1, :-1] = -decay
        return np.asarray(solve_banded((1, 0), band, right, check_finite=False))

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        j, s = self.joint or 0, view.samples
        z = self.states(s.v[j], s.sign[j], view.starts, size, view.dt_s)
        gauss, samples = np.zeros_like(view.gauss.q), np.zeros_like(s.q)
        gauss[j] = self.law(replace(view.gauss, state=view.to_gauss(z)), size, view)
        samples[j] = self.law(replace(s, state=z), size, view)
        return Perturbation(gauss, samples)


class SensorEffect(Effect):
    """An amount added to what a sensor reads."""

    @abstractmethod
    def readings(self, view: View, size: FloatArray) -> dict[Channel, FloatArray]:
        """Contribution to each channel's reading, (N,)."""

    def perturb(self, view: View, size: FloatArray) -> Perturbation:
        return Perturbation(readings=self.readings(view, size))


class BodyEffect(Effect):
    """A body more, which a simulation moves with the others: through the motion before, it would feel itself."""

    @abstractmethod
    def body(self, mechanism: Mechanism, beta: FloatArray, size: FloatArray) -> tuple[Mechanism, FloatArray]:
        """The mechanism with a joint more, the last one, and its parameters."""

    @abstractmethod
    def body_motion(self, view: View, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) angle and rate of that joint, with the motion in `view`."""
