"""Signature of an effect: the residual of the fit over the variable that the effect depends on."""

from __future__ import annotations

import numpy as np

from daq import FloatArray
from estimator.diagnosis.model import Model
from estimator.diagnosis.result import Signature
from estimator.effects import Axis, Effect, View
from estimator.signals import Channel

BINS = 24
LABELS: dict[Axis, tuple[str, str]] = {
    "v": ("velocity of joint {j}", "rad/s"), "u": ("what the motor gives", "N m"), "q": ("joint {j}", "rad"),
    "a": ("acceleration of joint {j}", "rad/s2"), "session": ("session time", "s"),
    "du": ("rate of what the motor gives", "N m/s"), "turn": ("the motor's angle within a turn", "turn")}
"""What is meant, and its unit on a rotary joint under torque."""


def abscissa(kind: Axis, view: View, joint: int) -> FloatArray:
    """(N,) natural variable of an effect."""
    s = view.samples
    if kind == "du":
        return np.asarray(np.gradient(s.u[-1], view.dt_s))
    if kind == "turn":
        return np.asarray(view.gear_ratio * s.q[joint] / (2.0 * np.pi) % 1.0)
    return {"v": s.v[joint], "u": s.u[-1], "q": s.q[joint], "a": s.a[joint], "session": s.session_s}[kind]


def signature(nominal: Model, extended: Model, effect: Effect) -> Signature | None:
    """Binned left-over of the sensor that shows `effect` most, nominal and extended; None where it adds nothing."""
    mechanism = extended.split.mechanism
    kind, joint = effect.depends_on, effect.shown_at(mechanism)
    size = dict(zip((e.key for e in extended.effects), extended.sizes()))[effect.key]
    x = extended.state.x
    view = extended.problem.view(x, extended.state.beta[: mechanism.p])
    added = effect.perturb(view, size)
    # what an effect adds to both its joint's torque and its encoder (a gear) shows in the encoder
    if added.torque_at_samples is not None and not any(c.kind == "encoder" for c in added.readings):
        row = int(np.argmax(np.std(added.torque_at_samples, axis=1)))
        curve, y_label = added.torque_at_samples[row], f"residual, joint {row + 1} [{mechanism.force_unit}]"
        before = _torque_left(nominal)[:, row]
        after = _torque_left(extended)[:, row]
        sign = -1.0
    elif added.readings:
        channel = max(added.readings, key=lambda c: float(np.mean(np.abs(added.readings[c]))))
        curve, y_label, sign = added.readings[channel], f"reading of {channel}", 1.0
        before, after = _reading_left(nominal, channel), _reading_left(extended, channel)
    else:
        return None
    along = abscissa(kind, view, joint)
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    which = np.clip(np.searchsorted(edges, along) - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(which, minlength=BINS), 1)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(which, values, BINS) / count)

    error = np.sqrt(np.maximum(mean(before**2) - mean(before) ** 2, 0.0) / np.maximum(count / 10.0, 1.0))
    label, unit = LABELS[kind]
    x_label = f"{label.format(j=joint + 1)} [{mechanism.unit(unit)}]"
    return Signature(effect.key, x_label, y_label, mean(along), sign * mean(before), error,
                     mean(curve), sign * mean(after))


def _torque_left(model: Model) -> FloatArray:
    """(N, n) measured torque less the estimated true one."""
    return model.problem.torque - model.problem.motor_torque(model.state.x, model.state.beta)


def _reading_left(model: Model, channel: Channel) -> FloatArray:
    """(N,) measured less predicted reading of one sensor."""
    residuals = model.problem.linearise(model.state.x, model.state.beta, model.state.noise).residuals
    number = channel.joint or 0
    if channel.kind in ("accel_x", "accel_y"):
        return -residuals["accel"][number, :, ("accel_x", "accel_y").index(channel.kind)]
    return -residuals["gyro"][number] if channel.kind == "gyro" else -residuals[channel.kind][:, number]
