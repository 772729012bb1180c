"""Checks of the controller's connection and of its firmware."""

from __future__ import annotations

import json
import math
import os
import subprocess
import time
from pathlib import Path

from daq import ControllerDevice, InputError, Rig
from daq.recording import check_drive
from drivers import VERSION, Drive, Reaction, State, describe_faults, fault_remedy, hello_of
from experiments.doctor.check import Check
from experiments.judge import GOOD_TIMER_MS

PROC = Path("/proc")
GEAR_TOLERANCE = 1e-3
IP_TIMEOUT_S = 5.0
TELEMETRY_WAIT_S = 1.0
CLEAR_WAIT_S = 0.5


def before_opening(device: ControllerDevice) -> list[Check]:
    """Checks without opening the port: who else has it; state and bit rate of a CAN interface."""
    if device.can is not None:
        return [can_interface(str(device.can.get("channel", "can0")), device.can)] \
            if device.can.get("interface") == "socketcan" else []
    port = Path(device.port)
    if not port.exists():
        return []  # opening it says so
    allowed = os.access(port, os.R_OK | os.W_OK)
    rights = Check("serial permissions", "ok", f"{device.port} may be read and written") if allowed else \
        Check("serial permissions", "FAIL", f"{device.port} may not be read and written; sudo usermod -aG "
                                            f"{_group(port)} $USER, then log in again")
    users = holders(port)
    use = Check("exclusive use", "ok", "no other program that this user can see has the port open")
    if users:
        use = Check("exclusive use", "FAIL", f"{device.port} is open in {', '.join(users)}; close it (a modem manager: "
                                             "sudo systemctl stop ModemManager)")
    return [rights, use]


def _group(port: Path) -> str:
    try:
        return port.group()
    except (KeyError, OSError):
        return "dialout"


def holders(port: Path) -> list[str]:
    """Other processes that have the port open, `name (pid)`; those of other users are seen by root only.

    Whoever serves a pseudo-terminal (an emulated rig) has its far end open too, and is no rival.
    """
    target, found = str(port.resolve()), []
    for process in PROC.glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            opened = {os.readlink(handle) for handle in (process / "fd").iterdir()}
            if target in opened and not (target.startswith("/dev/pts/") and "/dev/ptmx" in opened):
                found.append(f"{(process / 'comm').read_text().strip()} ({process.name})")
        except OSError:
            continue
    return sorted(found)


def can_interface(channel: str, config: dict[str, str | int | float | bool]) -> Check:
    """State and bit rate of a socketcan interface, as `ip -details -json link show` gives them."""
    name = "CAN state and bitrate"
    try:
        done = subprocess.run(["ip", "-details", "-json", "link", "show", channel], capture_output=True, text=True,
                              timeout=IP_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Check(name, "warn", f"cannot be looked up ({error}); install iproute2")
    try:
        facts = next(entry for entry in json.loads(done.stdout or "[]") if entry.get("ifname") == channel)
    except (ValueError, StopIteration):
        return Check(name, "FAIL", f"{channel}: no such interface; plug the adapter in, or correct "
                                   "[devices.controller.can] channel")
    info = facts.get("linkinfo", {})
    data = info.get("info_data", {})
    state, bitrate = data.get("state", ""), data.get("bittiming", {}).get("bitrate")
    wanted = config.get("bitrate")
    up = f"sudo ip link set {channel} up type can bitrate {wanted or bitrate or 1_000_000}"
    if "UP" not in facts.get("flags", []):
        return Check(name, "FAIL", f"{channel} is down; {up}")
    words = f"{channel} is up" + (f", {state.lower()}" if state else "") + (f", {bitrate} bit/s" if bitrate else "")
    if state == "BUS-OFF":
        return Check(name, "FAIL", f"{words}; check wiring, termination and bit rate, then sudo ip link set {channel} "
                                   f"down; {up}")
    if wanted is not None and bitrate is not None and int(wanted) != int(bitrate):
        return Check(name, "FAIL", f"{words}, the rig says {wanted}; sudo ip link set {channel} down; {up}")
    if state not in ("", "ERROR-ACTIVE"):
        return Check(name, "warn", f"{words}: the bus has errors; check wiring and termination")
    return Check(name, "ok", words)


def after_opening(controller: Drive, rig: Rig, device: ControllerDevice, told: bool) -> list[Check]:
    """Firmware, settings that both sides must agree on (where `told`: a rig file says them), timer, faults."""
    hello = hello_of(controller)
    words = controller.words or f"speaks protocol version {hello.version}, as this program does"
    checks = [Check("firmware version", "ok", words)]
    if hello.version != VERSION:  # opening refuses it too
        checks = [Check("firmware version", "FAIL", f"protocol version {hello.version}, this program has {VERSION}; "
                                                    "flash matching firmware")]
    wrong = []
    if abs(hello.gear_ratio - rig.motor.gear_ratio) > GEAR_TOLERANCE * hello.gear_ratio:
        wrong.append(f"[motor] gear_ratio is {rig.motor.gear_ratio:g}, the firmware's {hello.gear_ratio:g}")
    if device.watchdog_ms > hello.watchdog_ms:
        wrong.append(f"watchdog_ms is {device.watchdog_ms}, the firmware allows {hello.watchdog_ms}")
    if rig.limits.torque_nm > hello.torque_limit_nm:
        wrong.append(f"[limits] torque_nm is {rig.limits.torque_nm:g}, the firmware's {hello.torque_limit_nm:g}")
    if round(device.rate_hz) != hello.telemetry_hz:
        wrong.append(f"rate_hz is {device.rate_hz:g}, the firmware sends {hello.telemetry_hz}")
    if told:
        checks.append(Check("firmware settings", "FAIL",
                            f"{', '.join(wrong)}; make the rig file and the firmware agree") if wrong else
                      Check("firmware settings", "ok", "gear ratio, limits, watchdog and rate agree"))
    if controller.capabilities.lacks:
        checks += _drive_alone(controller, rig)
    return [*checks, *_latency(controller, device), _faults(controller)]


def _drive_alone(controller: Drive, rig: Rig) -> list[Check]:
    """What a drive without legid's firmware limits, refuses and does not do."""
    checks = [Check("drive's watchdog", "FAIL", controller.refusal)] if controller.refusal else []
    limits, hello = controller.limits, controller.hello
    if limits is not None and hello is not None:
        ends = [f"{end:.3g}" if math.isfinite(end) else "no limit" for end in (limits.position_min_rad,
                                                                              limits.position_max_rad)]
        checks.append(Check("drive's limits", "ok", f"torque {hello.torque_limit_nm:.3g} N m, speed "
                            f"{limits.speed_limit_radps:.3g} rad/s, knee {' to '.join(dict.fromkeys(ends))} rad, of "
                            f"the joint; at a lost host: {Reaction(limits.reaction).name.lower()}"))
    elif hello is not None and not controller.refusal:
        checks.append(Check("drive's limits", "warn", "it reports none; legid writes [limits] to it when it is armed"))
    try:
        check_drive(rig, controller)
    except InputError as error:
        checks.append(Check("knee's encoder", "FAIL", f"{error.what}; {error.remedy}"))
    return checks + [Check("not in this drive", "warn", f"{lack.what}; instead: {lack.instead}")
                     for lack in controller.capabilities.lacks]


def _latency(controller: Drive, device: ControllerDevice) -> list[Check]:
    if device.can is not None:
        return []
    timer = controller.link_facts.get("latency_timer_ms")
    if not isinstance(timer, int):
        return [Check("latency timer", "ok", "this port has none")]
    if timer > GOOD_TIMER_MS:
        name = Path(device.port).resolve().name
        return [Check("latency timer", "FAIL", f"{timer} ms; echo {GOOD_TIMER_MS} | sudo tee "
                                               f"/sys/bus/usb-serial/devices/{name}/latency_timer")]
    return [Check("latency timer", "ok", f"{timer} ms")]


def clear_faults(controller: Drive) -> None:
    """Have latched faults forgotten, and wait for telemetry that says so; what is older still shows them."""
    controller.clear_faults()
    deadline = time.monotonic() + CLEAR_WAIT_S
    while time.monotonic() < deadline and (controller.telemetry is None or controller.telemetry.faults):
        controller.poll()


def _faults(controller: Drive) -> Check:
    """A drive that has latched a fault will not arm."""
    deadline = time.monotonic() + TELEMETRY_WAIT_S
    while controller.telemetry is None and time.monotonic() < deadline:
        controller.poll()
    telemetry = controller.telemetry
    if telemetry is None:
        return Check("drive", "FAIL", "answers, but sends no telemetry; check the firmware")
    if telemetry.faults or telemetry.state == State.FAULT:
        said = f" ({controller.words})" if controller.words else ""
        return Check("drive", "FAIL", f"has latched: {describe_faults(telemetry.faults)}{said}; "
                                      f"{fault_remedy(telemetry.faults)}")
    return Check("drive", "ok", f"disarmed, no fault, supply {telemetry.bus_v:.1f} V")
