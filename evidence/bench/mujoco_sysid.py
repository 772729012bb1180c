"""MuJoCo's own identification toolbox, `mujoco.sysid`, on the same leg: free-run simulation against the sensors.

Eight parameters: both links' inertia and centre of mass, viscous and dry friction of both joints. Masses and the
upper link's length are given (a balance and a ruler), because they cannot be told apart from the others; the first
state is given too. Its residual is the sensors' error over their noise, the torque is taken as exact.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import sysid

from evidence.bench.record import Recorded, Watch

XML = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="pivot" type="hinge" axis="0 -1 0" damping="0.01" frictionloss="0.01"/>
      <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="{i1} {i1} {i1}"/>
      <site name="imu" pos="0 0 -{lever}"/>
      <body name="lower" pos="0 0 -{l1}">
        <joint name="knee" type="hinge" axis="0 -1 0" damping="0.01" frictionloss="0.01"/>
        <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="{i2} {i2} {i2}"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="knee"/></actuator>
  <sensor>
    <jointpos name="encoder" joint="knee"/>
    <jointvel name="gyro" joint="pivot"/>
    <accelerometer name="accel" site="imu"/>
  </sensor>
</mujoco>
"""
COLUMNS = [0, 1, 2, 4]
"""Of the sensors those that the record has: an accelerometer's y axis lies across the plane."""
NOISE = np.array([2.2e-4, 0.005, 0.05, 0.05])
"""Standard deviations of the record's knee encoder, gyro and accelerometer."""


class Found(NamedTuple):
    """Parameters beta (9,) and the seconds spent."""

    beta: np.ndarray
    seconds: float


def _inertia(value: float) -> list[float]:
    return [value, value, value]


def _parameters() -> sysid.ParameterDict:
    """Bounds a factor of about three around a guess a third off."""
    def body(name: str, attribute: str, guess: float, spread: float) -> sysid.Parameter:
        def put(spec: mujoco.MjSpec, p: sysid.Parameter) -> None:
            value = float(p.value[0])
            setattr(spec.body(name), attribute, _inertia(value) if attribute == "inertia" else [0.0, 0.0, -value])
        return sysid.Parameter(f"{name}_{attribute}", guess, guess / spread, guess * spread, modifier=put)

    def joint(name: str, attribute: str) -> sysid.Parameter:
        def put(spec: mujoco.MjSpec, p: sysid.Parameter) -> None:
            value = float(p.value[0])
            setattr(spec.joint(name), attribute, [value, 0.0, 0.0] if attribute == "damping" else value)
        return sysid.Parameter(f"{name}_{attribute}", 0.01, 0.0, 0.3, modifier=put)

    out = sysid.ParameterDict()
    for part in (body("upper", "inertia", 0.015, 4.0), body("upper", "ipos", 0.13, 3.0),
                 body("lower", "inertia", 0.009, 4.0), body("lower", "ipos", 0.12, 3.0),
                 joint("pivot", "damping"), joint("knee", "damping"),
                 joint("pivot", "frictionloss"), joint("knee", "frictionloss")):
        out.add(part)
    return out


def solve(recorded: Recorded, step: float) -> Found:
    """Fit with the simulation's time step [s]; a hundredth is the record's own."""
    data, (m1, m2), l1 = recorded.data, recorded.masses, recorded.length
    spec = mujoco.MjSpec.from_string(XML.format(step=step, m1=m1, m2=m2, l1=l1, lever=recorded.mechanism.lever_arm,
                                                c1=0.13, i1=0.015, c2=0.12, i2=0.009))
    model = spec.compile()
    zero = np.zeros(len(data.time_s))
    measured = np.column_stack([data["q2_rad"], data["gyro_radps"], data["accel_x_mps2"], zero,
                                -data["accel_y_mps2"]])
    watch = Watch()
    sequences = sysid.ModelSequences(
        "leg", spec, "record", sysid.create_initial_state(model, np.zeros(2), np.zeros(2)),
        sysid.TimeSeries(data.time_s, data["tau2_nm"][:, None]),
        sysid.TimeSeries.from_names(data.time_s, measured, model))

    def over_noise(_params: object, predicted: sysid.TimeSeries, told: sysid.TimeSeries, *_: object,
                 **__: object) -> tuple[np.ndarray, sysid.TimeSeries, sysid.TimeSeries]:
        """Error over noise; a simulation's sensors belong to the moment before its step."""
        every = round(1.0 / (data.rate_hz * step))
        error = told.data[: len(told) - 1, COLUMNS] - predicted.data[::every, COLUMNS][: len(told) - 1]
        return error / NOISE, predicted, predicted

    residual = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=over_noise)
    found, _ = sysid.optimize(initial_params=_parameters(), residual_fn=residual, optimizer="mujoco", verbose=False)
    seconds = watch.seconds()
    i1, c1, i2, c2, d1, d2, f1, f2 = found.as_vector()
    return Found(np.array([i1 + m1 * c1**2 + m2 * l1**2, i2 + m2 * c2**2, m2 * l1 * c2, m1 * c1 + m2 * l1, m2 * c2,
                           d1, d2, f1, f2]), seconds)
