"""An emulated leg whose hidden cause is undone by its drive: recorded without the cause, with it, and compensated."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from daq import Dataset, Rig, parse_rig
from daq.recording import Plan, record_run
from daq.runs import read_run
from daq.timing import align
from drivers import ImuConfig, Lsm9ds1, attach
from drivers.mock import EmulatorLink, VirtualClock
from experiments.emulation.drive_rig import rig_with_drive
from experiments.emulation.emulated_rig import emulate
from experiments.emulation.hidden_effects import Hidden
from experiments.emulation.plant import LegBody
from experiments.models import EffectValue, Model, load_model
from experiments.rig import wiring
from tests.support.models import LEG, write_model
from tests.support.paths import DEMO_RIG

AMPLITUDE, ORDER, PHASE = 0.15, 7.0, 3.0
"""Of the ripple [N m, a turn, rad]. The phase keeps a leg without torque near zero, where the plan begins."""
RIPPLE = Hidden("torque_ripple", 2, "cogging", torques=(
    lambda t, motion, torque: (0.0, AMPLITUDE * float(np.sin(ORDER * motion[1] + PHASE))),))
VALUE = EffectValue(name="torque_ripple", joint=2, sizes={"sine_amplitude": AMPLITUDE * math.cos(PHASE),
                                                          "cosine_amplitude": AMPLITUDE * math.sin(PHASE)},
                    shapes={"order": ORDER})
DIRECT = {"motor_position.rotor_to_output_ratio": 1.0, "motor_position.output.offset": 0.0,
          "motor_position.output.sign": 1.0}
"""Settings of a moteus without a gear."""
ASYMMETRIC = EffectValue(name="asymmetric_friction", joint=2, sizes={"coulomb_difference": 0.03,
                                                                     "viscous_difference": 0.0}, shapes={})
SPRING = EffectValue(name="joint_stiffness", joint=2, sizes={"stiffness": 0.45, "preload": 0.045}, shapes={})
T = np.arange(0.0, 8.0, 0.01)
PLAN = Plan(T, 0.5 * np.sin(2 * np.pi * 0.4 * T) + 0.25 * np.sin(2 * np.pi * 1.1 * T))


def direct(kind: str) -> tuple[Rig, str]:
    """The demo's rig with this drive and no gear."""
    text = rig_with_drive(DEMO_RIG.read_text(), kind).replace("gear_ratio = 50.0", 'gear_ratio = 1.0\nside = "motor"')
    text = text.replace("[limits]\n", "[limits]\ntorque_band_nm = 0.25  # the table's current counts as torque\n")
    return parse_rig(text), text


def extended(folder: Path, *effects: EffectValue) -> Model:
    """The emulated leg's model with these causes."""
    b = LegBody()
    beta = [b.i1 + b.m1 * b.c1**2 + b.m2 * b.l1**2, b.i2 + b.m2 * b.c2**2, b.m2 * b.l1 * b.c2,
            b.m1 * b.c1 + b.m2 * b.l1, b.m2 * b.c2, b.viscous[0], b.viscous[1], b.coulomb[0], b.coulomb[1]]
    model = load_model(write_model(folder / "nominal.json", beta, LEG))
    count = len(beta) + sum(len(e.sizes) + len(e.shapes) for e in effects)
    return msgspec.structs.replace(model, effects=effects, reach=((-1.5, 1.5), (-2.6, 2.6)),
                                   covariance=((0.0,) * count,) * count)


def record(folder: Path, kind: str, plan: Plan, hidden: Hidden, settings: dict[str, float] | None = None) -> Dataset:
    """A run of an emulated leg on a drive of this kind that was configured so before."""
    rig, text = direct(kind)
    clock = VirtualClock()
    mock = emulate(rig, 1, clock, None, hidden)
    device = rig.devices.controller
    assert device is not None and rig.devices.imu is not None
    link = EmulatorLink(mock.drive, clock, seed=1, nothing=getattr(mock.drive, "nothing", b""))
    path = folder / f"{len([*folder.glob('*.mcap')])}.mcap"
    with attach(kind, link, replace(wiring(device, rig), can=None), clock.now_ns, clock.sleep) as drive:
        drive.open()
        if settings:
            drive.configure(settings)  # type: ignore[attr-defined]
        imu = Lsm9ds1(mock.imu, config=ImuConfig(rig.devices.imu.rate_hz), now_ns=clock.now_ns, sleep=clock.sleep)
        imu.open()
        record_run(path, rig, text, plan, imu, drive, clock.now_ns, threaded=False)
    return align(read_run(path), rig)


def apart(one: Dataset, other: Dataset) -> float:
    """RMS difference of the knees of two runs over the plan [rad]."""
    a, b = (run["q2_rad"][np.flatnonzero(np.abs(run["tau2_cmd_nm"]) > 0)[0]:][:int(7.5 * run.rate_hz)]
            for run in (one, other))
    return float(np.sqrt(np.nanmean((a - b) ** 2)))
