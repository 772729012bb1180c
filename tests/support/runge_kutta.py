"""One step of classical Runge-Kutta for a motion whose acceleration is known."""

from collections.abc import Callable

from daq import FloatArray


def step(acceleration: Callable[[FloatArray, FloatArray], FloatArray], q: FloatArray, v: FloatArray, h: float
         ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places and velocities a time h later, and the acceleration at the start."""
    a1 = acceleration(q, v)
    v2 = v + 0.5 * h * a1
    a2 = acceleration(q + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = acceleration(q + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = acceleration(q + h * v3, v4)
    return q + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4), a1
