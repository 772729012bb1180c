"""The example port, built by the cross compiler and run in QEMU: its UART, its button, its memory."""

import functools
import json
import os
import re
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from daq.recording.workers import REAL_TIME_PRIORITY
from drivers import Closing
from tests.support.c_firmware import SOURCES
from tests.support.leg_on_a_link import settle

CC, QEMU = "arm-none-eabi-gcc", "qemu-system-arm"
PORT = SOURCES / "port_lm3s6965"
CORE = [SOURCES / f"leg_{part}.c" for part in ("core", "config", "codec")]
STRICT = ["-mthumb", "-std=c99", "-O2", "-ffreestanding", "-Wall", "-Wextra", "-Werror"]
HANG, RETURN = b"\xfe\xe7", b"\x70\x47"
"""Thumb: `b .`, `bx lr`."""


def returns(value: int) -> bytes:
    """Thumb: `movw r0`, `movt r0`, `bx lr`."""
    moves = [(0xF240, value & 0xFFFF), (0xF2C0, value >> 16)]
    return b"".join(struct.pack("<HH", code | half >> 12 | (half >> 11 & 1) << 10, (half >> 8 & 7) << 12 | half & 0xFF)
                    for code, half in moves) + RETURN


def needs(*programs: str) -> None:
    """Skips the test where one of them is not installed."""
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"no {program} here: Debian packages gcc-arm-none-eabi, qemu-system-arm")


@functools.cache
def elf() -> Path:
    """The port, built once a process."""
    needs(CC)
    out = Path(tempfile.mkdtemp(prefix="leg_port_")) / "port.elf"
    subprocess.run([CC, "-mcpu=cortex-m3", *STRICT, "-nostdlib", "-T", PORT / "lm3s6965.ld", "-o", out,
                    *sorted(PORT.glob("*.c")), *CORE, "-lgcc"], check=True)
    return out


@functools.cache
def symbols() -> dict[str, int]:
    """Addresses by name."""
    lines = subprocess.run(["arm-none-eabi-nm", elf()], capture_output=True, text=True, check=True).stdout.splitlines()
    return {name: int(address, 16) & ~1 for address, _, name in (line.split() for line in lines)}


@contextmanager
def ahead(priority: int, policy: int = os.SCHED_RR) -> Iterator[None]:
    """This process has a processor whenever it wants one; skips where that is refused."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        pytest.skip("no right to real-time priority here: a line would be late, and the board's own watchdog bite")
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


class Trace(NamedTuple):
    """Ticks of the board [us]; 0: not since power-up."""

    loop_us: int
    """The last current loop."""
    driven_us: int
    """The last that gave the bridge a torque."""
    first_us: int
    """The first that did."""


class Board(Closing):
    """One board, powered up; ahead of other programs where that is granted, for its watchdog knows no excuse."""

    def __init__(self) -> None:
        needs(CC, QEMU)
        self._places = Path(tempfile.mkdtemp(prefix="leg_qemu_"))
        words = [str(QEMU), "-M", "lm3s6965evb", "-kernel", str(elf()), "-display", "none", "-monitor", "none",
                 "-serial", "pty", "-qmp", f"unix:{self._places}/qmp,server=on,wait=off",
                 "-gdb", f"unix:{self._places}/gdb,server=on,wait=off"]
        with ahead(4 * REAL_TIME_PRIORITY):  # what is started meanwhile too, as a board has its processor
            self._child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self._child.stdout is not None
        said = re.search(r"/dev/\S+", self._child.stdout.readline())
        assert said is not None
        self.path = said[0]
        """The UART's port."""
        self.resets_s: list[float] = []
        """When the emulator made each, by the hardware watchdog or by `reset`, on the clock of `time.time`."""
        self._line = self._connect("qmp").makefile("rw")
        self._line.readline()
        self._do("qmp_capabilities")
        symbols()  # now: who asks for the memory later is in a hurry

    @property
    def resets(self) -> int:
        """Since power-up."""
        return len(self.resets_s)

    def _connect(self, name: str) -> socket.socket:
        line = socket.socket(socket.AF_UNIX)
        settle(lambda: (self._places / name).exists())
        line.connect(str(self._places / name))
        return line

    def _do(self, what: str, **arguments: Any) -> Any:
        self._line.write(json.dumps({"execute": what, "arguments": arguments}) + "\n")
        self._line.flush()
        while True:
            answer = json.loads(self._line.readline())
            if answer.get("event") == "RESET":
                self.resets_s.append(answer["timestamp"]["seconds"] + answer["timestamp"]["microseconds"] * 1e-6)
            if "return" in answer:
                return answer["return"]
            assert "event" in answer, answer

    def estop(self, pressed: bool) -> None:
        """Press or release the button. After power-up the emulated pin is low, as if pressed, until a change."""
        for down in ([True] if pressed else [True, False]):
            key = {"type": "key", "data": {"down": down, "key": {"type": "qcode", "data": "ctrl"}}}
            self._do("input-send-event", events=[key])

    def _words(self, symbol: str, count: int) -> list[int]:
        said = self._do("human-monitor-command", **{"command-line": f"xp /{count}wd {symbols()[symbol]:#x}"})
        return [int(word) for word in said.split()[1:count + 1]]

    def bridge_nm(self) -> float:
        """Torque that the bridge is given now, out of the board's memory [N m]."""
        return self._words("bridge_torque_unm", 1)[0] * 1e-6

    def trace(self) -> Trace:
        """What the current loop left in memory that a reset keeps."""
        return Trace(*(word % 2**32 for word in self._words("trace", 3)))

    def reset(self) -> None:
        """The reset pin."""
        self._do("system_reset")

    def stop_clock(self, stopped: bool) -> None:
        """Hold the processor and all that the board counts time with, or let them go on."""
        self._do("stop" if stopped else "cont")

    def signal(self, number: int) -> None:
        """To the emulator's process: SIGSTOP holds the processor, and time goes on."""
        self._child.send_signal(number)

    def zero_after_s(self, from_s: float) -> float:
        """Time from then until the bridge was last asked and had a torque [s]; who asks may be late, not the board."""
        last_s = asked_s = time.monotonic()
        while self.bridge_nm():
            assert asked_s < from_s + 2.0, "still driven"
            last_s, asked_s = asked_s, time.monotonic()
        return last_s - from_s

    def patch(self, function: str, code: bytes) -> bytes:
        """Put other code where a function begins, as a debugger does; returns what stood there. Resets keep it."""
        place = f"{symbols()[function]:x},{len(code):x}"
        with self._connect("gdb") as line:  # which halts the board
            before, *_ = (self._debug(line, packet) for packet in (f"m{place}", f"M{place}:{code.hex()}", "D"))
        return bytes.fromhex(before)

    @staticmethod
    def _debug(line: socket.socket, packet: str) -> str:
        line.sendall(f"${packet}#{sum(packet.encode()) % 256:02x}".encode())
        got = b""
        while True:
            got += line.recv(256)
            replies = [part.partition(b"#")[0].decode() for part in got.split(b"$")[1:] if b"#" in part[:-2]]
            wanted = [reply for reply in replies if not reply.startswith("T")]  # T: that it has halted
            if wanted:
                line.sendall(b"+" * len(replies))
                return wanted[0]

    def close(self) -> None:
        """Power off."""
        self._child.kill()
        self._child.wait()
        shutil.rmtree(self._places)
