"""Checks of sensors that stand alone on an I2C bus: the pivot sensor with its magnet, the second current shunt."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from daq import InputError, Rig, second_torque
from daq.recording import Sensors
from drivers import CurrentShunt, DriverError, as5600
from experiments.doctor.check import Check, Heard
from experiments.rig import devices

RATE_SHARE = 0.8
"""Of the rate that was asked for; a busy machine or bus gives less."""
SHUNT_SHARE = 0.005
"""Offset of the shunt that counts, as a share of the torque limit."""
JITTER_COUNTS = 8
"""Standard deviation of the angle's counts at rest that no filter of the chip leaves: 0.7 degrees."""


def open_for_checks(stack: ExitStack, rig: Rig, where: str) -> tuple[list[Check], Sensors]:
    """Devices that can be opened, and a check for each device that cannot."""
    checks, pivot, shunt = [], None, None
    if rig.devices.pivot is not None:
        try:
            pivot = stack.enter_context(devices.open_pivot(rig.devices.pivot))
        except DriverError as error:
            checks.append(Check("pivot sensor", "FAIL", str(error)))
    if rig.devices.shunt is not None:
        try:
            shunt = stack.enter_context(devices.open_shunt(rig.devices.shunt, where))
        except (DriverError, InputError) as error:
            checks.append(Check("second shunt", "FAIL", str(error)))
    return checks, Sensors(pivot, shunt)


def judge(heard: Heard, rig: Rig, sensors: Sensors) -> list[Check]:
    """Checks of a record in which nothing was commanded."""
    checks = []
    if sensors.pivot is not None:
        checks += [_rate("pivot sensor", heard, "/pivot", rig.devices.pivot.rate_hz if rig.devices.pivot else 0.0),
                   _magnet(heard)]
    if sensors.shunt is not None:
        checks += [_rate("second shunt", heard, "/shunt", rig.devices.shunt.rate_hz if rig.devices.shunt else 0.0),
                   _current(heard, rig, sensors.shunt)]
    return checks


def _rate(name: str, heard: Heard, topic: str, asked_hz: float) -> Check:
    readings = heard.raw.streams[topic]
    rate = readings.size / heard.seconds
    took = readings["host_after_ns"] - readings["host_before_ns"]
    words = f"{rate:.0f} readings/s ({asked_hz:g} asked for)"
    if not readings.size:
        return Check(name, "FAIL", "none came; check its wiring")
    words += f", each time known to {0.5e-3 * float(np.percentile(took, 95)):.0f} us"
    if rate < RATE_SHARE * asked_hz:
        return Check(name, "warn", f"{words}; raise the bus clock, or lower rate_hz")
    return Check(name, "ok", words)


def _magnet(heard: Heard) -> Check:
    """The magnet's state over all readings: the worst one counts."""
    readings = heard.raw.streams["/pivot"]
    name = "pivot magnet"
    if not readings.size:
        return Check(name, "FAIL", "no reading; check its wiring")
    states = sorted({int(status) for status in readings["status"]}, key=lambda s: (s & as5600.MD, -s))
    problem, gain = as5600.magnet_problem(states[0]), int(np.median(readings["agc"]))
    words = f"gain {gain}, best is 128 at 5 V and 64 at 3.3 V; field {readings['magnitude'][-1]}"
    if problem:
        lost = not states[0] & as5600.MD
        return Check(name, "FAIL" if lost else "warn", f"{problem}; {words}")
    steps = (np.diff(readings["raw"].astype(int)) + as5600.COUNTS // 2) % as5600.COUNTS - as5600.COUNTS // 2
    jitter = float(np.std(steps)) / np.sqrt(2.0)
    if jitter > JITTER_COUNTS:
        return Check(name, "warn", f"the angle jumps by {jitter:.0f} counts at rest; hold the leg still, keep currents "
                                   f"and magnets away from the chip; {words}")
    return Check(name, "ok", words)


def _current(heard: Heard, rig: Rig, shunt: CurrentShunt) -> Check:
    """Its zero with the motor off, as a torque, and its range against the torque limit."""
    readings, name = heard.raw.streams["/shunt"], "second shunt zero"
    good = readings[readings["flags"] == 0]
    if good.size < 2:
        return Check(name, "FAIL", "no valid reading; check shunt_ohm and wiring")
    c, limits = rig.calibration, rig.limits
    torque = second_torque(good["raw"] * shunt.amperes_per_count, rig)
    mean, error = float(torque.mean()), 2.0 * float(torque.std()) / np.sqrt(good.size)
    offset = mean / c.torque_constant_nm_per_a + c.second_shunt_offset_a
    most = limits.torque_nm / abs(c.torque_constant_nm_per_a)
    words = f"{mean:+.3g} +- {error:.1g} N m with the motor off, range {shunt.range_a:.3g} A"
    if most > shunt.range_a:
        return Check(name, "FAIL", f"{words}, but [limits] torque_nm is {most:.3g} A; use a shunt of less resistance, "
                                   "or lower the limit")
    if abs(mean) > max(SHUNT_SHARE * limits.torque_nm, 2.5 * error):
        return Check(name, "FAIL", f"{words}; set [calibration] second_shunt_offset_a = {offset:.4f}")
    return Check(name, "ok", words)
