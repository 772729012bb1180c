"""A planar walker on level ground as truth: masses on rigid legs, a landing found as it happens, an impact.

Three bodies on point feet (Grizzle, Abba and Plestan 2001): two equal legs, of which one stands, and a torso at the
hip. Everything is made of the positions of five points, sum_i C[k, i] u(theta_i) with u = (sin, cos) of an angle from
upright, by their Jacobians; nothing is shared with the estimator. A leg's angle is that of foot to hip.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np

from daq import Dataset, FloatArray
from tests.support import runge_kutta

GRAVITY = 9.8
Law = Callable[[int, float, float, float], float]
"""(leg 0 or 1, hip angle torso less leg, its rate, motor's torque) -> torque that the hip takes [N m]"""
RIG = """[mechanism]
model = "biped3"
actuated = [2, 3]
gravity_mps2 = 9.8
[walker]
[sampling]
rate_hz = 100.0
hold = "zero"
[noise]
torque_nm = 0.3
encoder_rad = [2e-3, 2e-4, 2e-4]
passive_nm = 0.05
"""
"""rig.toml of the plant's records, as `record` disturbs them."""


def no_loss(leg: int, angle: float, rate: float, torque: float) -> float:
    return 0.0


@dataclass(frozen=True)
class Walker:
    """Masses [kg] and lengths [m]: leg (centre `centre_m` above the foot), hip, torso."""

    leg_kg: float = 5.0
    hip_kg: float = 15.0
    torso_kg: float = 10.0
    leg_m: float = 1.0
    centre_m: float = 0.55
    torso_m: float = 0.5
    leg_inertia: float = 0.15
    torso_inertia: float = 0.4

    @property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Masses (4,) of stance leg, hip, swing leg, torso, and C (4, 3) by angle of stance leg, swing leg, torso."""
        r, a = self.leg_m, self.centre_m
        return (np.array([self.leg_kg, self.hip_kg, self.leg_kg, self.torso_kg]),
                np.array([[a, 0.0, 0.0], [r, 0.0, 0.0], [r, a - r, 0.0], [r, 0.0, self.torso_m]]))

    @property
    def spin(self) -> FloatArray:
        """(3,) inertia of each body about its centre."""
        return np.array([self.leg_inertia, self.leg_inertia, self.torso_inertia])

    @property
    def beta(self) -> FloatArray:
        """(8,) of the paper's eq. (58), by hand: its second link is counted from the hip down, its third from the hip
        up, hip and torso are one body."""
        r, a, b = self.leg_m, self.centre_m, self.leg_m - self.centre_m
        m, top = self.leg_kg, self.hip_kg + self.torso_kg
        own = self.leg_inertia
        first = np.array([r * (m + top) + a * m, b * m, self.torso_m * self.torso_kg])
        return np.array([own + m * a**2 + r**2 * (m + top), own + m * b**2,
                         self.torso_inertia + self.torso_kg * self.torso_m**2, r * b * m,
                         r * self.torso_m * self.torso_kg, *(GRAVITY * first)])


@dataclass(frozen=True)
class Gait:
    """A controller: torso leans, the swing leg mirrors the stance leg with the foot lifted; and what perturbs it."""

    lean_rad: float = 0.52
    impact_rad: float = np.pi / 8
    lift_rad: float = 0.15
    bandwidth: float = 10.0
    dither_nm: float = 4.0
    """Standard deviation of torques added, of some tones, so that steps differ."""
    sway_rad: float = 0.04
    """Amplitude of each of two tones in which the torso nods, so that it shows its weight."""
    landing_radps: float = 2.0
    """Stance leg's rate at landing that it walks with: ..."""
    steer_s: float = 0.15
    """... what is lacking, times this, the torso leans further."""


@dataclass(frozen=True)
class Walk:
    """What happened. Samples are held torques' instants, `period_s` apart."""

    time_s: FloatArray
    """(N,)"""
    angles: FloatArray
    """(N, 3) legs 1 and 2 and torso, from upright [rad]"""
    rates: FloatArray
    torque: FloatArray
    """(N, 2) of the hips' motors, leg 1 and leg 2, held until the next sample"""
    stance: FloatArray
    """(N,) 1 or 2"""
    touchdown_s: FloatArray
    """Times at which a foot landed."""
    before: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    """State (stance, swing, torso angles; rates) just before each landing, ..."""
    after: list[FloatArray] = field(default_factory=list)
    """... and rates (old stance, old swing, torso) just after it."""


class Plant:
    """The walker as differential equations."""

    def __init__(self, walker: Walker, loss: Law = no_loss) -> None:
        self.walker, self.loss = walker, loss
        self.mass, self.place = walker.points
        self.spin = walker.spin

    def equation(self, angle: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inertia matrix (3, 3) and bias (3,) of D a + h = Q in absolute angles."""
        sin, cos = np.sin(angle), np.cos(angle)
        jx, jz = self.place * cos, -self.place * sin
        weighted_x, weighted_z = self.mass[:, None] * jx, self.mass[:, None] * jz
        inertia = jx.T @ weighted_x + jz.T @ weighted_z
        inertia[[0, 1, 2], [0, 1, 2]] += self.spin
        square = rate * rate
        bias = weighted_x.T @ (self.place @ (-sin * square)) + weighted_z.T @ (self.place @ (-cos * square) + GRAVITY)
        return inertia, bias

    def acceleration(self, angle: FloatArray, rate: FloatArray, torque: FloatArray, stance: int) -> FloatArray:
        """(3,) under the motors' torques (2,) of stance hip and swing hip."""
        inertia, bias = self.equation(angle, rate)
        u = [torque[k] - self.loss(stance if k == 0 else 1 - stance, angle[2] - angle[k], rate[2] - rate[k], torque[k])
             for k in (0, 1)]
        return np.asarray(np.linalg.solve(inertia, np.array([-u[0], -u[1], u[0] + u[1]]) - bias), float)

    def advance(self, angle: FloatArray, rate: FloatArray, torque: FloatArray, stance: int, h: float
                ) -> tuple[FloatArray, FloatArray]:
        """State a time h later, classical Runge-Kutta."""
        return runge_kutta.step(lambda x, v: self.acceleration(x, v, torque, stance), angle, rate, h)[:2]

    def land(self, angle: FloatArray, rate: FloatArray) -> FloatArray:
        """(3,) rates just after the swing foot has landed: the foot's impulse F is found with the walker afloat.

        D_e (v+ - v-) = E^T F, E v+ = 0, in three angles and the old stance foot's place (section II-C of the paper).
        """
        sin, cos = np.sin(angle), np.cos(angle)
        def afloat(place: FloatArray) -> tuple[FloatArray, FloatArray]:
            return np.append(place * cos, [1.0, 0.0]), np.append(-place * sin, [0.0, 1.0])

        inertia = np.diag(np.append(self.spin, [0.0, 0.0]))
        for mass, place in zip(self.mass, self.place):
            for j in afloat(place):
                inertia += mass * np.outer(j, j)
        foot = np.array(afloat(np.array([self.walker.leg_m, -self.walker.leg_m, 0.0])))
        before = np.append(rate, [0.0, 0.0])
        system = np.block([[inertia, -foot.T], [foot, np.zeros((2, 2))]])
        return np.linalg.solve(system, np.append(inertia @ before, [0.0, 0.0]))[:3]

    def control(self, gait: Gait, angle: FloatArray, rate: FloatArray, sway: FloatArray) -> FloatArray:
        """(2,) torques of stance and swing hip that bring lean and swing leg to where they shall be; `sway` (3,) is
        what the torso shall lean beside, its rate and acceleration."""
        inertia, bias = self.equation(angle, rate)
        x, top = angle[0], gait.impact_rad
        lift = gait.lift_rad * (1.0 - (x / top) ** 2)
        slope = -2.0 * gait.lift_rad * x / top**2
        error = np.array([angle[1] + x + lift, angle[2] - gait.lean_rad - sway[0]])
        rows = np.array([[1.0 + slope, 1.0, 0.0], [0.0, 0.0, 1.0]])
        curve = np.array([-2.0 * gait.lift_rad / top**2 * rate[0] ** 2, 0.0])
        ahead = np.array([0.0, sway[1]]), np.array([0.0, sway[2]])
        wanted = ahead[1] - 2.0 * gait.bandwidth * (rows @ rate - ahead[0]) - gait.bandwidth**2 * error - curve
        inverse = np.linalg.inv(inertia)
        into = np.array([[-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])
        return np.linalg.solve(rows @ inverse @ into, wanted + rows @ inverse @ bias)


def walk(plant: Plant, gait: Gait, steps: int, rng: np.random.Generator, rate_hz: float = 200.0, substeps: int = 2
         ) -> Walk:
    """`steps` steps, from about the middle of the gait. Raises RuntimeError where the walker falls."""
    top, period = gait.impact_rad, 1.0 / rate_hz
    angle = np.array([top, -top, gait.lean_rad])
    rate = plant.land(angle, np.array([1.6, -1.6, 0.0]))
    angle, rate, stance = angle[[1, 0, 2]], rate[[1, 0, 2]], 0
    asked = gait
    tones = rng.uniform(6.0, 30.0, (2, 6)), rng.uniform(0.0, 2 * np.pi, (2, 6))
    nods = rng.uniform([7.0, 11.0], [11.0, 16.0]), rng.uniform(0.0, 2 * np.pi, 2)
    rows: list[tuple[FloatArray, FloatArray, FloatArray, int]] = []
    landed: list[float] = []
    before = []
    after = []
    while len(landed) < steps:
        now = len(rows) * period
        dither = gait.dither_nm / np.sqrt(3.0) * np.sin(tones[0] * now + tones[1]).sum(axis=1)
        nod = gait.sway_rad * np.exp(1j * (nods[0] * now + nods[1]))
        sway = np.array([np.sum(nod.imag), np.sum((1j * nods[0] * nod).imag), np.sum((-(nods[0] ** 2) * nod).imag)])
        torque = plant.control(gait, angle, rate, sway) + dither
        rows.append((angle, rate, torque, stance))
        left = period
        for k in range(substeps):
            h = left / (substeps - k)
            next_angle, next_rate = plant.advance(angle, rate, torque, stance, h)
            if next_angle[0] > 0.1 and next_angle[0] + next_angle[1] >= 0.0 > angle[0] + angle[1]:
                low, high = 0.0, h
                for _ in range(50):
                    mid = 0.5 * (low + high)
                    found = plant.advance(angle, rate, torque, stance, mid)
                    low, high = (low, mid) if found[0][0] + found[0][1] >= 0.0 else (mid, high)
                angle, rate = plant.advance(angle, rate, torque, stance, high)
                landed.append(now + period - left + high)
                before.append((angle, rate))
                gait = replace(asked, lean_rad=asked.lean_rad + asked.steer_s * (asked.landing_radps - float(rate[0])))
                rate = plant.land(angle, rate)
                after.append(rate)
                angle, rate, torque, stance = angle[[1, 0, 2]], rate[[1, 0, 2]], torque[[1, 0]], 1 - stance
                next_angle, next_rate = plant.advance(angle, rate, torque, stance, h - high)
            angle, rate = next_angle, next_rate
            left -= h
        if not abs(angle[0]) < 1.0:
            raise RuntimeError(f"the walker falls after {now:.2f} s, {len(landed)} steps")
    legs = np.array([s for *_, s in rows])
    first = legs == 0

    def by_leg(values: FloatArray) -> FloatArray:
        out = values.copy()
        out[~first, 0], out[~first, 1] = values[~first, 1], values[~first, 0]
        return out

    angles, rates, torques = (by_leg(np.array([row[i] for row in rows])) for i in range(3))
    return Walk(period * np.arange(float(len(rows))), angles, rates, torques, legs + 1.0, np.array(landed), before,
                after)


@dataclass(frozen=True)
class Sensors:
    """1 sigma of the torso's absolute angle, the hips' encoders and the motors' torques."""

    torso_rad: float = 2e-3
    encoder_rad: float = 2e-4
    torque_nm: float = 0.3


def record(name: str, found: Walk, rng: np.random.Generator, sensors: Sensors = Sensors(), stance: bool = True
           ) -> Dataset:
    """The walk as a record of rig.toml's [walker]: torso, torso against either leg, both motors."""
    torso, legs = found.angles[:, 2], found.angles[:, :2]
    count = found.time_s.size
    columns = {"q1_rad": torso + sensors.torso_rad * rng.normal(size=count)}
    for j in (0, 1):
        columns[f"q{j + 2}_rad"] = torso - legs[:, j] + sensors.encoder_rad * rng.normal(size=count)
        columns[f"tau{j + 2}_nm"] = found.torque[:, j] + sensors.torque_nm * rng.normal(size=count)
    if stance:
        columns["stance"] = found.stance
    return Dataset(name, 1.0 / float(found.time_s[1]), found.time_s, columns)


def random_walker(rng: np.random.Generator) -> Walker:
    """A body of its own: masses, lengths and inertias up to an eighth larger or smaller."""
    usual = Walker()
    return Walker(**{f.name: float(getattr(usual, f.name) * rng.uniform(0.88, 1.125)) for f in fields(Walker)})


def roles(found: Walk) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Angles, rates and torques (N, 3) of every step in the joints torso, torso against the leg that stands, torso
    against the one that swings (half a turn from it hanging down is where the paper counts from: that is the model's
    affair)."""
    out = []
    for where in np.split(np.arange(found.time_s.size), np.flatnonzero(np.diff(found.stance)) + 1):
        order = [0, 1] if found.stance[where[0]] == 1 else [1, 0]
        angle, rate = ((x[where, 2, None] - x[where][:, order]) for x in (found.angles, found.rates))
        torque = np.column_stack([np.zeros(where.size), found.torque[where][:, order]])
        out.append((np.column_stack([found.angles[where, 2], angle]), np.column_stack([found.rates[where, 2], rate]),
                    torque))
    return out
