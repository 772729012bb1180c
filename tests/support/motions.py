"""Healthy joints that move in many ways, by integration of their own: what a look at readings must leave as it is."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

Columns = dict[str, np.ndarray]
MOST_STEP_S = 1e-2
ENCODERS = {"fine": 2.0 * np.pi / 65536, "2400 counts": 2.0 * np.pi / 2400, "hobby": 2.0 * np.pi / 300}


def pendulum(time_s: np.ndarray, torque: Callable[[float], float], q0: float, qd0: float = 0.0,
             friction: tuple[float, float] = (0.4, 0.5), stiffness: float = 64.0) -> np.ndarray:
    """Angle (n,) of q'' = torque(t) - stiffness sin q - viscous and dry friction."""
    def rate(t: float, state: np.ndarray) -> tuple[float, float]:
        q, v = state
        return v, torque(t) - stiffness * np.sin(q) - friction[0] * v - friction[1] * np.tanh(v / 0.02)

    found = solve_ivp(rate, (time_s[0], time_s[-1]), [q0, qd0], t_eval=time_s, max_step=MOST_STEP_S, rtol=1e-6)
    return np.asarray(found.y[0])


def swing_to_rest(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    return {"q1_rad": pendulum(time_s, lambda t: 0.0, rng.uniform(0.4, 2.6), 0.0, (rng.uniform(0.3, 1.5), 0.5))}


def whirl(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    """Swings first, is then driven over the top, and turns on and on."""
    start, push, f = 0.3 * time_s[-1], rng.uniform(75.0, 90.0), rng.uniform(0.4, 0.8)

    def torque(t: float) -> float:
        return 30.0 * np.sin(2.0 * np.pi * f * t) + (push if t > start else 0.0)

    return {"q1_rad": pendulum(time_s, torque, 0.2, 0.0, (5.0, 0.5)), "tau1_nm": np.array([torque(t) for t in time_s])}


def whirl_wrapped(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    columns = whirl(time_s, rng)
    return {**columns, "q1_rad": columns["q1_rad"] % (2.0 * np.pi)}


def dwell(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    """A servo that goes quickly between positions, 20 rad/s and 1000 rad/s2 at most, and stays there."""
    places = rng.choice(np.array([-0.5, 0.0, 0.5, 1.0]) * np.pi, 60)
    q, v, target, out = 0.0, 0.0, 0.0, np.empty(time_s.size)
    for k, t in enumerate(time_s.tolist()):
        out[k] = q
        target = places[int(t / 0.9) % 60]
        step = 0.0 if k + 1 == time_s.size else float(time_s[k + 1]) - t
        for _ in range(many := max(1, int(np.ceil(step / 5e-4)))):
            h = step / many
            left = target - q
            wanted = np.sign(left) * min(20.0, np.sqrt(2.0 * 900.0 * abs(left)))
            v += np.clip(wanted - v, -1000.0 * h, 1000.0 * h)
            q += h * v
    return {"q1_rad": out, "q1_cmd_rad": places[(time_s / 0.9).astype(int) % 60]}


def tiny(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    """A few counts of motion, and a noisy torque."""
    f = rng.uniform(0.3, 1.0)
    return {"q1_rad": 0.004 * np.sin(2.0 * np.pi * f * time_s) + 1e-4 * rng.normal(size=time_s.size),
            "tau1_nm": 0.5 * np.sin(2.0 * np.pi * f * time_s + 0.3) + 0.02 * rng.normal(size=time_s.size)}


def driven(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    """Several tones, as of an excitation."""
    tones, phases = rng.uniform(0.2, 1.5, 4), rng.uniform(0.0, 2.0 * np.pi, 4)

    def torque(t: float) -> float:
        return 20.0 * float(np.sin(2.0 * np.pi * tones * t + phases).sum())

    return {"q1_rad": pendulum(time_s, torque, 0.0), "tau1_nm": np.array([torque(t) for t in time_s])}


def held_then_released(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    hold = rng.uniform(0.1, 0.4) * time_s[-1]
    behind = time_s >= hold
    q = rng.uniform(0.5, 2.5) + 0.01 * np.sin(3.0 * time_s)
    q[behind] = pendulum(time_s[behind] - hold, lambda t: 0.0, q[~behind][-1])
    return {"q1_rad": q}


def stick_slip(time_s: np.ndarray, rng: np.random.Generator) -> Columns:
    """A slow sine that the joint follows in jerks of 0.2 rad, each within 30 ms."""
    wanted, q, out = 0.8 * np.sin(2.0 * np.pi * 0.1 * time_s), 0.0, np.empty(time_s.size)
    goal = 0.0
    for k, one in enumerate(wanted.tolist()):
        out[k] = q
        goal = one if abs(one - goal) > 0.2 else goal
        q += (goal - q) * (1.0 - np.exp(-(time_s[1] - time_s[0]) / 0.01))
    return {"q1_rad": out, "tau1_nm": 3.0 * (wanted - out)}


MOTIONS = {"swing to rest": swing_to_rest, "whirl": whirl, "whirl, wrapped": whirl_wrapped, "dwell": dwell,
           "tiny motion": tiny, "driven": driven, "held, then released": held_then_released, "stick-slip": stick_slip}


def healthy(kind: str, rate_hz: float, encoder: str, seed: int, seconds: float = 20.0) -> tuple[np.ndarray, Columns]:
    """Times (n,) and columns (n,) of one record; angles as the encoder reads them."""
    rng = np.random.default_rng([seed, list(MOTIONS).index(kind), round(rate_hz)])
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    columns, step = MOTIONS[kind](time_s, rng), ENCODERS[encoder]
    return time_s, {name: np.round(x / step) * step if name == "q1_rad" else x for name, x in columns.items()}
