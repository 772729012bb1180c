"""How fast a drive is polled on the real clock, and at what cost: its emulator in one process, the poll in another."""

import json
import os
import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np

from daq.recording.workers import real_time
from drivers import Wiring, open_drive
from drivers.mock import CanServer, FirmwareSettings, MockRig, PtyServer, RealClock, drive_facts, drive_maker, on_serial
from experiments.emulation.drive_rig import local_can
from tests.support.paths import ROOT
from tests.support.still_plant import StillPlant

PLACES = (("moteus", "can"), ("moteus", "pty"), ("odrive", "can"), ("dynamixel", "pty"))
WIRES = {"moteus pty": "an fdcanusb on a PTY", "moteus can": "CAN FD in UDP datagrams",
         "odrive can": "CAN in UDP datagrams", "dynamixel pty": "a PTY"}
POLLED_HZ = {"moteus": 510.0}
"""Where not at the drive's usual rate: asked at 500 Hz exactly, a single answer that is lost leaves less."""
AT_ONCE = 2
"""Drives that are measured together: their four processes need less than one of two cores."""
COMMAND_S = 0.01
WATCHDOG_MS = 500


def serve(kind: str, can: str) -> None:
    """The drive until standard input ends; its port, or nothing for CAN, is the first line."""
    import can as python_can

    wiring = Wiring(node=drive_facts(kind).node, gear_ratio=50.0, turns=50.0, watchdog_ms=WATCHDOG_MS)
    mock = MockRig(StillPlant(), RealClock(), firmware=FirmwareSettings(), make=drive_maker(kind, wiring))
    settings = json.loads(can)
    server: CanServer | PtyServer
    with real_time():  # a drive shares its processor with nobody; the server's thread inherits it
        if settings:
            server = CanServer(mock.drive, python_can.Bus(**settings), mock.clock)
            print("", flush=True)
        else:
            server = PtyServer(on_serial(kind, mock.drive), mock.clock)
            print(server.path, flush=True)
    while sys.stdin.readline():
        continue
    server.close()


def poll(kind: str, port: str, can: str, seconds: float) -> dict[str, Any]:
    """Poll and command for so long; what came of it."""
    facts, settings = drive_facts(kind), json.loads(can)
    wire, rate_hz = "can" if settings else "pty", POLLED_HZ.get(kind, facts.rate_hz)
    wiring = Wiring(port=port, can=settings or None, node=facts.node, rate_hz=rate_hz, gear_ratio=50.0, turns=50.0,
                    watchdog_ms=WATCHDOG_MS)
    with real_time(), open_drive(kind, wiring) as drive:
        drive.open(10.0)
        drive.arm(WATCHDOG_MS)
        waits: list[int] = []
        warm = time.monotonic() + 2.0
        end, due, began, used, lost = warm + seconds, 0.0, 0.0, 0.0, 0
        while (now := time.monotonic()) < end:
            if not began and now >= warm:
                began, used, waits, lost = now, _used(), [], drive.stats.lost
            if now >= due:
                due = now + COMMAND_S
                drive.command(0.2)
            waits += [one.host_ns - one.asked_ns for one in drive.poll() if one.asked_ns is not None]
        span = time.monotonic() - began
        return {"kind": kind, "over": WIRES[f"{kind} {wire}"], "seconds": seconds,
                "rate": len(waits) / span, "lost": drive.stats.lost - lost, "share": (_used() - used) / span,
                "wait_ms": float(np.median(waits)) * 1e-6, "armed": drive.armed,
                "words": drive.words}


def _used() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def at_rate(seconds: float) -> dict[str, Any]:
    """Every drive on every wire that its emulator is served on, AT_ONCE together."""
    rows, load = [], os.getloadavg()[1]
    for first in range(0, len(PLACES), AT_ONCE):
        running = []
        for kind, wire in PLACES[first : first + AT_ONCE]:
            settings = local_can() if wire == "can" else {}
            can = json.dumps(settings)
            server = _child("serve", kind, can)
            assert server.stdout is not None
            port = server.stdout.readline().strip()
            running.append((server, _child("poll", kind, port, can, f"{seconds:g}")))
        for server, polling in running:
            out, _ = polling.communicate(timeout=seconds + 120.0)
            rows.append(json.loads(out))
            server.communicate(timeout=30.0)
    return {"rows": rows, "load": load, "load_after": os.getloadavg()[1]}


def _child(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", "evidence.drive_rates", *arguments], cwd=ROOT, text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            env={**os.environ, "PYTHONPATH": str(ROOT)})


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        serve(sys.argv[2], sys.argv[3])
    else:
        print(json.dumps(poll(sys.argv[2], sys.argv[3], sys.argv[4], float(sys.argv[5]))))
