"""The default estimator's problem in CasADi, solved by IPOPT.

Written as one who knows both would: the equations of one interval as a small expression graph, mapped over the
record, sums of squares with a Gauss-Newton Hessian (exact Hessians take three to ten times as long, here and with
residuals as constraints), started from the same filtered motion. Unlike legid it is handed the noise levels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from estimator.likelihood import slack_of
from evidence.bench.record import Posed, Watch

GAUSS = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))
GRAVITY = 9.81


def torque(q: list[Any], v: list[Any], a: list[Any], sign: list[Any], b: ca.SX) -> ca.SX:
    """(2,) joint torque of the hanging leg at angles, rates, accelerations and rounded signs of both rates."""
    c, s = ca.cos(q[1]), -ca.sin(q[1])
    w, f = v[0] + v[1], a[0] + a[1]
    upper = b[0] * a[0] + b[2] * (c * f + s * w**2) + b[3] * GRAVITY * ca.sin(q[0])
    lower = b[1] * f + b[2] * (c * a[0] - s * v[0] ** 2) + b[4] * GRAVITY * ca.sin(q[0] + q[1])
    return ca.vertcat(upper + lower + b[5] * v[0] + b[7] * sign[0], lower + b[6] * v[1] + b[8] * sign[1])


def defect_function(dt: float, eps: float) -> ca.Function:
    """(4,) what the equation of motion lacks at the two Gauss points between two samples (q, v, u)."""
    left, right, b, s = ca.SX.sym("left", 6), ca.SX.sym("right", 6), ca.SX.sym("beta", 9), ca.SX.sym("s")
    rows = []
    curve = [(2 * s**3 - 3 * s**2 + 1) * left[j] + (s**3 - 2 * s**2 + s) * dt * left[2 + j]
             + (3 * s**2 - 2 * s**3) * right[j] + (s**3 - s**2) * dt * right[2 + j] for j in range(2)]
    rate = [ca.jacobian(x, s) / dt for x in curve]
    accel = [ca.jacobian(x, s) / dt for x in rate]
    for g, at in enumerate(GAUSS):
        q, v, a = ([ca.substitute(x, s, at) for x in xs] for xs in (curve, rate, accel))
        ends = [[ca.substitute(x, s, 0.5 * (g + k)) for x in rate] for k in (0, 1)]
        sign = [(x + y) / (ca.sqrt(x**2 + eps**2) + ca.sqrt(y**2 + eps**2)) for x, y in zip(*ends)]
        rows.append(torque(q, v, a, sign, b) - (1 - at) * left[4:6] - at * right[4:6])
    return ca.Function("defect", [left, right, b], [ca.vertcat(*rows)])


def sensor_function(lever: float, eps: float) -> ca.Function:
    """(6,) knee angle, gyro, accelerometer x and y, both torques at one sample (q, v, u)."""
    x, b = ca.SX.sym("x", 6), ca.SX.sym("beta", 9)
    q, v = [x[0], x[1]], [x[2], x[3]]
    sign = [r / ca.sqrt(r**2 + eps**2) for r in v]
    bias = torque(q, v, [0, 0], sign, b)
    across = b[1] + b[2] * ca.cos(q[1])
    whole = b[0] + b[1] + 2 * b[2] * ca.cos(q[1])
    accel = (b[1] * (x[4] - bias[0]) - across * (x[5] - bias[1])) / (whole * b[1] - across**2)
    return ca.Function("sensors", [x, b], [ca.vertcat(
        q[1], v[0], lever * accel + GRAVITY * ca.sin(q[0]), -lever * v[0] ** 2 - GRAVITY * ca.cos(q[0]), x[4:6])])


class Solved(NamedTuple):
    """Parameters, sum of squares and the seconds spent."""

    beta: np.ndarray
    objective: float
    iterations: int
    build_s: float
    solve_s: float


def solve(posed: Posed, tolerance: float = 1e-7) -> Solved:
    """Minimise at the noise levels in `posed.end`, from the motion and parameters in `posed.start`.

    Ends when two steps in turn change the sum of squares by less than this share of it.
    """
    p, noise, first = posed.problem, posed.end.noise, posed.start
    mechanism = p.mechanism
    watch = Watch()
    x, b = ca.MX.sym("x", 6, p.total), ca.MX.sym("beta", 9)
    levels = np.tile([noise.encoder[1], noise.gyro[0], *noise.accel[0]], (p.total, 1))
    weight = 1.0 / np.concatenate([levels, np.sqrt(p.torque_variance(noise))], axis=1).T
    measured = np.concatenate([[p.angles[:, 1], p.gyro[0], *p.accel[0]], p.torque.T])
    smoothing = mechanism.velocity_scale
    assert isinstance(smoothing, float)
    sensors = sensor_function(mechanism.lever_arm, smoothing).map(p.total)(x, b)
    defects = defect_function(p.dt, smoothing).map(p.total - 1)(x[:, :-1], x[:, 1:], b)
    scale = np.tile(np.tile(1.0 / (slack_of(mechanism) * noise.torque), 2)[:, None], p.total - 1)
    residual = ca.vertcat(ca.vec((sensors - measured) * weight), ca.vec(defects * scale))
    unknown = ca.vertcat(ca.vec(x), b)
    jacobian = ca.jacobian(residual, unknown)
    factor, none = ca.MX.sym("factor"), ca.MX.sym("none", 0)
    hessian = ca.Function("hessian", [unknown, none, factor, none], [factor * ca.triu(jacobian.T @ jacobian)],
                          ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"])
    solver = ca.nlpsol("fit", "ipopt", {"x": unknown, "f": 0.5 * ca.sumsqr(residual)}, {
        "hess_lag": hessian, "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 200, "nlp_scaling_method": "none",
                  "acceptable_iter": 2, "acceptable_tol": 1e20, "acceptable_dual_inf_tol": 1e20,
                  "acceptable_obj_change_tol": tolerance}})
    built = watch.seconds()
    start = np.concatenate([np.concatenate([first.x.q, first.x.v, first.x.u], axis=1).ravel(), first.beta])
    solution = solver(x0=start)
    done = watch.seconds()
    if not solver.stats()["success"]:
        raise RuntimeError(solver.stats()["return_status"])
    return Solved(np.array(solution["x"]).ravel()[-9:], 2.0 * float(solution["f"]),
                  solver.stats()["iter_count"], built, done - built)
