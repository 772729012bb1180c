"""The reference firmware core, compiled with the system's C compiler, and the same scripts for it and the emulator."""

import functools
import math
import queue
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from drivers import Closing, Reaction
from drivers.can_codec import CanCodec
from drivers.can_frame import CanFrame, Frames
from drivers.mock import FirmwareSettings, MockRig, VirtualClock
from drivers.protocol import Decoder
from tests.support.paths import ROOT
from tests.support.still_plant import StillPlant

SOURCES = ROOT / "firmware"
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
STEP_US = 500
PATIENCE_S = 60.0


def compiler() -> str:
    """The system's C compiler; skips the test where there is none."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        pytest.skip("no C compiler here: cc, gcc or clang")
    return found


@functools.cache
def host_program() -> Path:
    """leg_host, compiled once a process with undefined behaviour trapped."""
    out = Path(tempfile.mkdtemp(prefix="leg_host_")) / "leg_host"
    subprocess.run([compiler(), *STRICT, "-fsanitize=undefined", "-fsanitize-undefined-trap-on-error", "-o", str(out),
                    *map(str, sorted(SOURCES.glob("*.c")))], check=True)
    return out


class Change(NamedTuple):
    """A line of leg_host's own record: state or torque changed."""

    t_us: int
    state: int
    torque_unm: int
    faults: int
    value: int


class Served(Closing):
    """leg_host on a pseudo-terminal, in a process of its own: it outlives whoever drives it."""

    def __init__(self, telemetry_hz: int = 500) -> None:
        self.child = subprocess.Popen([host_program(), "pty", str(telemetry_hz)], stdout=subprocess.PIPE, text=True)
        assert self.child.stdout is not None
        self.path = self.child.stdout.readline().strip()
        self.changes: list[Change] = []
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self._lines.put(line)
        self._lines.put("")

    def record_until(self, ended: Callable[[Change], bool]) -> list[Change]:
        """What it did, up to the first change for which `ended` holds after torque was commanded."""
        while line := self._lines.get(timeout=PATIENCE_S):
            self.changes.append(Change(*map(int, line.split())))
            if any(c.torque_unm for c in self.changes) and ended(self.changes[-1]):
                return self.changes
        raise AssertionError("the firmware has gone")

    def close(self) -> None:
        """End the process."""
        self.child.kill()
        self.child.wait()


class Event(NamedTuple):
    """One line of a script: at `t_us`, `rx` HEX, `set` NAME VALUE, or `reboot`."""

    t_us: int
    verb: str
    what: str = ""
    value: int = 0


class Answer(NamedTuple):
    """All bytes sent, and how it ended."""

    sent: bytes
    state: int
    torque_unm: int
    dropped: tuple[int, ...]
    late: int = 0


MICRO_COUNTS = round(2e6 * math.pi)
"""Of an encoder that counts 1e-6 rad."""


def emulate(script: Iterable[Event], end_us: int, node: int | None = None) -> tuple[Answer, list[int]]:
    """The Python emulator's answer, and the boot ids that it drew; on CAN with a node, a frame a line."""
    clock = VirtualClock(0)
    settings = FirmwareSettings(current_noise_a=0.0, hall_noise_rad=0.0, clock_error_ppm=0.0, current_loop_s=0.0,
                                bus_resistance_ohm=0.0, heating_degc_per_a2=0.0, heating_time_s=1e15,
                                encoder_counts=MICRO_COUNTS, hall_counts=MICRO_COUNTS, brake_nms_per_rad=0.0)
    plant = StillPlant()
    rig = MockRig(plant, clock, firmware=settings, seed=3, codec=Decoder if node is None else lambda: CanCodec(node))
    firmware, boots, sent = rig.firmware, [rig.firmware.boot_id], b""

    def run_to(t_us: int) -> None:
        nonlocal sent
        while clock.now_ns() < t_us * 1000:
            clock.advance(STEP_US * 1000)
            sent += b"".join(as_bytes(chunk) for _, chunk in firmware.transmit(clock.now_ns()))

    for event in script:
        run_to(event.t_us if event.verb != "rx" else -(-event.t_us // STEP_US) * STEP_US)
        if event.verb == "rx":
            data = bytes.fromhex(event.what)
            firmware.receive(data if node is None else (CanFrame(int.from_bytes(data[:2], "big"), data[2:]),),
                             event.t_us * 1000)
        elif event.verb == "reboot":
            firmware.reboot()
            boots.append(firmware.boot_id)
        else:
            change(plant, firmware, event)
    run_to(end_us)
    drive, codec = firmware.drive, firmware.codec
    return Answer(sent, int(drive.state), round(drive.torque_nm * 1e6),
                  (codec.bad_crc, codec.bad_length, codec.unknown), drive.late), boots


def as_bytes(chunk: bytes | Frames) -> bytes:
    """A chunk as leg_host writes it: a CAN frame as its identifier, high byte first, and its data."""
    return chunk if isinstance(chunk, bytes) else b"".join(f.can_id.to_bytes(2, "big") + f.data for f in chunk)


def change(plant: StillPlant, firmware: Any, event: Event) -> None:
    """A reading of the emulator set by hand."""
    name, value = event.what, event.value
    lost = value == -(2**31)
    if name in ("knee_speed", "angle"):
        field = {"knee_speed": "q2d", "angle": "q2"}[name]
        plant.state = replace(plant.state, **{field: math.nan if lost else value * 1e-6})
    elif name == "reaction":
        firmware.settings = firmware.drive._settings = replace(firmware.settings, reaction=Reaction(value))
    else:
        attribute, reading = {
            "bus_mv": ("bus_v", math.nan if value == 65535 else value * 1e-3),
            "motor_cdegc": ("motor_degc", math.nan if value == -(2**15) else value * 1e-2),
            "estop": ("estop_open", bool(value)), "gate_driver": ("gate_driver_ok", not value),
            "current": ("current_ok", not lost), "knee": ("knee_encoder_ok", not lost),
            "knee_hall": ("knee_hall_ok", not lost), "pivot_hall": ("pivot_hall_ok", not lost)}[name]
        setattr(firmware, attribute, reading)


def run_core(script: Iterable[Event], end_us: int, boots: list[int], node: int | None = None) -> Answer:
    """The C core's answer to the same script."""
    left = iter(boots)
    lines = [f"0 reboot {next(left)}"]
    for event in script:
        what = f"{event.what} {event.value}" if event.verb == "set" else event.what or next(left)
        lines.append(f"{event.t_us} {event.verb} {what}")
    frames, (*dropped, late), (state, torque_unm, *_) = run_script([*lines, f"{end_us} end"], node)
    of_boot_1 = 1 if node is None else 3  # the Hello before the script's own boot
    return Answer(b"".join(frames[of_boot_1:]), state, torque_unm, tuple(dropped), late)


def run_script(lines: Iterable[str], node: int | None = None) -> tuple[list[bytes], list[int], list[int]]:
    """leg_host's (frames sent, counts, [state, torque, bridge, kicks]) after a script."""
    words = [str(host_program()), "script", *([] if node is None else [str(node)])]
    done = subprocess.run(words, input="\n".join(lines) + "\n", capture_output=True, text=True, check=True)
    *frames, counts, torque = done.stdout.splitlines()
    return ([bytes.fromhex(line.split()[1]) for line in frames],
            [int(word) for word in counts.split()[1:]], [int(word) for word in torque.split()[1:]])
