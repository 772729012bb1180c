"""`Mechanism`: a planar tree of rigid links as one linear-in-parameters model.

In absolute link angles theta = T q every planar tree has kinetic energy
1/2 sum_ij p_ij cos(theta_i - theta_j) thetad_i thetad_j and potential -sum_i g_i cos(theta_i), so the
equation of link i is (Lagrange, eq. (6) of Dolinsky and Celikovsky 2018)

    sum_j p_ij (cos(theta_i - theta_j) thetadd_j + sin(theta_i - theta_j) thetad_j^2) + g_i sin(theta_i)

and joint torques follow by virtual work, tau = T^T (.). The p_ij, g_i and the friction levels are beta.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from daq import FloatArray
from estimator.model.terms import TERMS, World

VELOCITY_SCALE = 0.005
"""Default friction smoothing velocity [rad/s]."""
Speeds = float | tuple[float, ...]
"""One for all joints, or one each."""


class Parameter(NamedTuple):
    """One entry of beta and the term of the model that it multiplies."""

    name: str
    meaning: str
    unit: str
    term: str
    """One of `TERMS`."""
    at: tuple[int, ...]
    """Links of a rigid term or joints of another, 0-based."""

    @property
    def rigid(self) -> bool:
        """Whether its term lives in absolute link angles; else in joint angles."""
        return TERMS[self.term].rigid


class ImuPlace(NamedTuple):
    """Place of an IMU."""

    link: int = 0
    """0-based"""
    lever_arm: float = 0.0
    """From the link's joint to the IMU along it [m]."""


@dataclass(frozen=True)
class Mechanism:
    """Regressor, inertia matrix, bias torque and forward dynamics, vectorised over leading axes."""

    name: str
    transform: FloatArray
    """(n, n) T of theta = T q + `zero`, entries 0, 1 or -1."""
    parameters: tuple[Parameter, ...]
    gravity: float
    """Factor of sin(theta) per unit of a gravity parameter: g where it is in kg m, -1 for an upright
    convention with g inside the parameter."""
    actuated: tuple[int, ...]
    """0-based joints whose torque is measured; the others carry exactly zero."""
    imus: tuple[ImuPlace, ...] = (ImuPlace(),)
    gravity_mps2: float = 9.81
    """Gravity as an accelerometer feels it [m/s2]."""
    velocity_scale: Speeds = VELOCITY_SCALE
    """Friction smoothing velocity v_s [rad/s]: sign(qd) is qd / sqrt(qd^2 + v_s^2)."""
    length_unit: str = field(default="rad")
    """Unit of q: rad, or m for a prismatic joint."""
    zero: tuple[float, ...] = ()
    """Links' angles where all joints are at zero [rad]; empty: zero."""
    exchanged: tuple[int, ...] = ()
    """Of a walker, the joints that change places with the legs: what they are as leg 1 stands, in reversed order as leg
    2 does. Empty where nothing does."""
    link_lengths: tuple[float, ...] = ()
    """Joint to joint [m], of the first links: as many as IMUs ride on."""
    followers: tuple[int, ...] = ()
    """Driven joints, 0-based, whose torque is not measured: a position loop makes it of a command."""

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.transform.shape[0])

    @property
    def p(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def force_unit(self) -> str:
        """Unit of what drives the joints: N m, N on a slide, V where the input is a motor's voltage."""
        return next((p.unit for p in self.parameters if p.term == "coulomb"), "N m")

    def unit(self, rotary: str) -> str:
        """A unit that is written for torques and angles, on this mechanism: of N m/rad makes N/m on a slide."""
        if self.force_unit == "N m":
            return rotary
        return rotary.replace("(N m)", self.force_unit).replace("N m", self.force_unit).replace("rad", self.length_unit)

    @property
    def passive(self) -> tuple[int, ...]:
        """Joints without a motor, 0-based."""
        return tuple(j for j in range(self.n) if j not in self.actuated)

    @property
    def lever_arm(self) -> float:
        """Lever arm of the first IMU [m]."""
        return self.imus[0].lever_arm

    def with_lever_arm(self, lever_arm: float) -> Mechanism:
        """The same with another `lever_arm` of the first IMU [m]."""
        return replace(self, imus=(self.imus[0]._replace(lever_arm=lever_arm), *self.imus[1:]))

    @property
    def felt_gravity(self) -> float:
        """`gravity_mps2` in an accelerometer's equations, whose angles count from hanging; where the mechanism's count
        from upright its sign is the other [m/s2]."""
        return -self.gravity_mps2 if self.gravity < 0.0 else self.gravity_mps2

    def joints_to(self, link: int) -> tuple[int, ...]:
        """0-based joints whose angles add up to the absolute angle of a link, its own last."""
        return self._paths[link]

    @cached_property
    def _paths(self) -> list[tuple[int, ...]]:
        return [(*(int(j) for j in np.flatnonzero(row) if j != link), link) for link, row in enumerate(self.transform)]

    def with_imus(self, imus: tuple[ImuPlace, ...], link_lengths: tuple[float, ...] = ()) -> Mechanism:
        """This mechanism with these IMUs. Raises ValueError for a link that there is not, or whose place needs a length
        that is not given, or where joints change places, and links with them."""
        if self.exchanged:
            raise ValueError("a walker whose hips change places has no IMUs: take out the table [[imu]]")
        for k, place in enumerate(imus):
            if not 0 <= place.link < self.n:
                raise ValueError(f"IMU {k + 1} is on link {place.link + 1}, {self.name} has {self.n}")
            unknown = [i for i in self.joints_to(place.link)[:-1] if i >= len(link_lengths)]
            if unknown:
                raise ValueError(f"IMU {k + 1} on link {place.link + 1} rides on link {unknown[0] + 1}, whose length "
                                 "is not given: give link_lengths_m under [mechanism], from link 1 on, joint to joint"
                                 )
        return replace(self, imus=imus, link_lengths=link_lengths)

    @cached_property
    def offset_columns(self) -> dict[int, int]:
        """Joint -> column of its constant torque offset."""
        return {a.at[0]: k for k, a in enumerate(self.parameters) if a.term == "offset"}

    def column(self, name: str) -> int:
        """Column of the parameter called `name`; KeyError where there is none."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    @cached_property
    def inertia_rows(self) -> FloatArray:
        """(p, n) diagonal of the inertia matrix, all joints straight, by parameter."""
        straight = np.zeros((1, self.n))
        return np.array([np.diag(self.inertia_matrix(straight, b)[0]) for b in np.eye(self.p)])

    @cached_property
    def world(self) -> World:
        """Constants that terms depend on in addition to the motion."""
        return World(self.gravity, self.velocity_scales)

    @cached_property
    def velocity_scales(self) -> FloatArray:
        """(n,) `velocity_scale` of each joint."""
        return np.array(np.broadcast_to(self.velocity_scale, self.n), dtype=float)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Z of tau = Z(q, qd, qdd) beta, eq. (13). Arguments (..., n) in rad, rad/s, rad/s2; Z (..., n, p)."""
        joints, links = self._motion(q, qd, qdd)
        z = np.zeros((self.n, self.p, *q.shape[:-1]))
        for k, parameter in enumerate(self.parameters):
            term, (x, v, a) = TERMS[parameter.term], links if parameter.rigid else joints
            parts = [(row, mass * a[column]) for row, column, mass in term.mass(parameter.at, x)]
            for row, values in [*parts, *term.bias(parameter.at, x, v, self.world)]:
                for joint in np.flatnonzero(self.transform[row]) if parameter.rigid else (row,):
                    z[joint, k] += (self.transform[row, joint] if parameter.rigid else 1.0) * values
        return np.moveaxis(z, (0, 1), (-2, -1))

    def _motion(self, *motion: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Joint and link angles, rates, ... (n, ...) from joint ones (..., n)."""
        joints = [np.moveaxis(x, -1, 0) for x in motion]
        links = [np.moveaxis(x @ self.transform.T, -1, 0) for x in motion]
        return joints, [self.from_zero(links[0]), *links[1:]]

    def from_zero(self, links: FloatArray) -> FloatArray:
        """Links' angles (n, ...) from what joints turn them by, T q."""
        return links + np.reshape(self.zero, (self.n, *(1,) * (links.ndim - 1))) if self.zero else links

    def inverse_dynamics(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, beta: FloatArray) -> FloatArray:
        """tau (..., n) [N m] that makes the motion happen; beta (..., p)."""
        return np.einsum("...np,...p->...n", self.regressor(q, qd, qdd), beta)

    def inertia_matrix(self, q: FloatArray, beta: FloatArray) -> FloatArray:
        """D(q) of eq. (8), (..., n, n) [kg m^2]; q (..., n), beta (..., p)."""
        joints, links = self._motion(q)
        lead = np.broadcast_shapes(q.shape[:-1], beta.shape[:-1])
        rigid, own = np.zeros((2, *lead, self.n, self.n))
        for k, parameter in enumerate(self.parameters):
            x, to = (links, rigid) if parameter.rigid else (joints, own)
            for row, column, mass in TERMS[parameter.term].mass(parameter.at, x[0]):
                to[..., row, column] += beta[..., k] * mass
        return np.swapaxes(self.transform, 0, 1) @ rigid @ self.transform + own

    def load_of_links(self, joint: int, q: FloatArray, qd: FloatArray, beta: FloatArray) -> FloatArray:
        """(...) what gravity and rates of the links ask of one joint at qdd = 0; q and qd (n, ...), beta (p,)."""
        x, v = self.from_zero(np.tensordot(self.transform, q, 1)), np.tensordot(self.transform, qd, 1)
        out = np.zeros(q.shape[1:])
        for value, parameter in zip(beta, self.parameters):
            for row, values in TERMS[parameter.term].bias(parameter.at, x, v, self.world) if parameter.rigid else ():
                if self.transform[row, joint]:
                    out += self.transform[row, joint] * value * values
        return out

    def bias_torque(self, q: FloatArray, qd: FloatArray, beta: FloatArray) -> FloatArray:
        """C qd + G + F of eq. (9), offsets included: the torque at qdd = 0, (..., n) [N m]."""
        joints, links = self._motion(q, qd)
        lead = np.broadcast_shapes(q.shape[:-1], beta.shape[:-1])
        rigid, own = np.zeros((2, *lead, self.n))
        for k, parameter in enumerate(self.parameters):
            (x, v), to = (links, rigid) if parameter.rigid else (joints, own)
            for row, values in TERMS[parameter.term].bias(parameter.at, x, v, self.world):
                to[..., row] += beta[..., k] * values
        return rigid @ self.transform + own

    def forward_dynamics(self, q: FloatArray, qd: FloatArray, tau: FloatArray, beta: FloatArray) -> FloatArray:
        """qdd (..., n) [rad/s2] under joint torques tau (..., n) [N m]."""
        excess = tau - self.bias_torque(q, qd, beta)
        solution = np.linalg.solve(self.inertia_matrix(q, beta), excess[..., None])[..., 0]
        return np.asarray(solution, dtype=np.float64)


def tree_parameters(pairs: list[tuple[int, int]], gravity: list[int], meanings: list[str],
                    gravity_unit: str = "kg m", mass_unit: str = "kg m^2") -> list[Parameter]:
    """beta1... for the inertias p_ij of `pairs`, then the gravity terms of the links in `gravity`."""
    terms: list[tuple[str, tuple[int, ...], str]] = [("inertia", pair, mass_unit) for pair in pairs]
    terms += [("gravity", (i,), gravity_unit) for i in gravity]
    return [Parameter(f"beta{k + 1}", meanings[k], unit, term, at) for k, (term, at, unit) in enumerate(terms)]


def friction_parameters(joints: list[int], labels: list[str], start: int, force: str = "N m",
                        rate: str = "N m s/rad") -> list[Parameter]:
    """Viscous, then Coulomb, parameters of `joints`, numbered from beta<start>."""
    rows = [("viscous", j, f"viscous friction, {label}", rate) for j, label in zip(joints, labels)]
    rows += [("coulomb", j, f"Coulomb friction, {label}", force) for j, label in zip(joints, labels)]
    return [Parameter(f"beta{start + k}", meaning, unit, term, (j,))
            for k, (term, j, meaning, unit) in enumerate(rows)]


def extra_parameters(rotor_inertia: tuple[int, ...], torque_offset: tuple[int, ...],
                     force: str = "N m", mass: str = "kg m^2") -> list[Parameter]:
    """Declared extra terms, joints 0-based: reflected rotor inertia, torque offset."""
    rotors = [Parameter(f"rotor_inertia_{j + 1}", f"reflected rotor inertia, joint {j + 1}", mass, "rotor", (j,))
              for j in rotor_inertia]
    offsets = [Parameter(f"torque_offset_{j + 1}", f"constant in the measured torque, joint {j + 1}", force,
                         "offset", (j,)) for j in torque_offset]
    return rotors + offsets


def leg2(*, gravity_mps2: float = 9.81, lever_arm: float = 0.0, actuated: tuple[int, ...] = (1,),
         rotor_inertia: tuple[int, ...] = (), torque_offset: tuple[int, ...] = (),
         velocity_scale: Speeds = VELOCITY_SCALE) -> Mechanism:
    """The 2-link leg hanging from its pivot, eq. (62), beta in the paper's order (docs/formats.md, fit JSON)."""
    rigid = tree_parameters(
        [(0, 0), (1, 1), (0, 1)], [0, 1],
        ["I1 + m1*lc1^2 + m2*l1^2", "I2 + m2*lc2^2", "m2*l1*lc2", "m1*lc1 + m2*l1", "m2*lc2"])
    friction = friction_parameters([0, 1], ["pivot", "knee"], 6)
    return Mechanism("leg2", np.array([[1.0, 0.0], [1.0, 1.0]]),
                     tuple(rigid + friction + extra_parameters(rotor_inertia, torque_offset)),
                     gravity_mps2, actuated, (ImuPlace(0, lever_arm),), gravity_mps2, velocity_scale)


def biped3(*, actuated: tuple[int, ...] = (1, 2), gravity_mps2: float = 9.8, hips: bool = False) -> Mechanism:
    """The 3-link walker of section V: both relative angles count from link 1, q1 from upright, g inside beta6-8.

    The printed G lost its third row, -beta8*s(1,3); it follows here from the potential. With `hips` the joints are
    those that a walker's motors turn: q1 the torso from upright, q2 and q3 the torso against the leg that stands and
    the one that swings, each leg from foot to hip. Beta is the same; the swing leg of the paper counts from the hip
    down, half a turn away. As the other leg stands, both hips change places; so would IMUs, and it has none.
    """
    rigid = tree_parameters(
        [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2)], [0, 1, 2],
        ["I1 + l1^2*m2 + l1^2*m3 + lc1^2*m1", "I2 + m2*lc2^2", "I3 + m3*lc3^2", "l1*lc2*m2", "l1*lc3*m3",
         "g*(l1*m2 + l1*m3 + lc1*m1)", "g*lc2*m2", "g*lc3*m3"], gravity_unit="N m")
    if hips:
        transform = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
        return Mechanism("biped3", transform, tuple(rigid), -1.0, actuated, (), gravity_mps2,
                         zero=(0.0, np.pi, 0.0), exchanged=(1, 2))
    transform = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
    return Mechanism("biped3", transform, tuple(rigid), -1.0, actuated, gravity_mps2=gravity_mps2)


def joint1(*, gravity_mps2: float = 9.81, prismatic: bool = False, actuated: tuple[int, ...] = (0,),
           torque_offset: tuple[int, ...] = (), velocity_scale: Speeds = VELOCITY_SCALE, voltage: bool = False,
           lever_arm: float = 0.0) -> Mechanism:
    """One joint, rotary or prismatic: inertia (or mass), gravity moment unless gravity is 0, friction.

    With `voltage` the input is a motor voltage and every parameter is in volts per unit of its term.
    """
    force = "V" if voltage else ("N" if prismatic else "N m")
    length = "m" if prismatic else "rad"
    mass = f"V s^2/{length}" if voltage else ("kg" if prismatic else "kg m^2")
    rigid = tree_parameters([(0, 0)], [0] if gravity_mps2 else [],
                            ["mass" if prismatic else "inertia" if voltage else "I1 + m1*lc1^2",
                             "m*lc" if prismatic or voltage else "m1*lc1"],
                            "V s^2/m" if voltage else "kg m", mass)
    friction = friction_parameters([0], ["joint"], len(rigid) + 1, force, f"{force} s/{length}")
    extra = extra_parameters((), torque_offset, force, mass)
    return Mechanism("joint1", np.eye(1), tuple(rigid + friction + extra), gravity_mps2, actuated,
                     (ImuPlace(0, lever_arm),), gravity_mps2, velocity_scale, length)
