"""Processes of the study of kills: an emulated rig, a forked command, a stranger at the IMU."""

import mmap
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import numpy as np

from daq import load_rig
from daq.runs import RunWriter
from drivers import DriverError, lsm9ds1_registers, open_bus, read_registers
from experiments.rig.devices import connect
from legid.cli import main as legid
from tests.support.paths import ROOT

PATIENCE_S = 20.0
COUNTS = struct.Struct("<QQ")
"""Messages given to the run's writer, and those of them handed to the system."""


@contextmanager
def served_rig(folder: Path) -> Iterator[Path]:
    """The rig file of an emulated rig in a process of its own."""
    rig = subprocess.Popen([sys.executable, "-m", "legid.cli", "emulate", "--out", str(folder), "--until-eof"],
                           stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT)
    assert rig.stdin is not None and rig.stdout is not None
    try:
        rig.stdout.readline()
        yield folder / "rig.toml"
    finally:
        rig.stdin.close()
        rig.wait(PATIENCE_S)


def start(arguments: Sequence[str], said: Path, counts: mmap.mmap | None = None, without: Sequence[int] = ()) -> int:
    """`legid ARGUMENTS` in a forked process: as from a shell, without the seconds of an interpreter's start, and
    without these descriptors."""
    pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        for descriptor in without:
            os.close(descriptor)
        with said.open("w") as file, redirect_stdout(file), redirect_stderr(file):
            if counts is not None:
                count(counts)
            status = legid(list(arguments))
    finally:
        os._exit(status)


def count(counts: mmap.mmap) -> None:
    """Keep the numbers of the run's writer where they outlive this process."""
    add: Callable[..., None] = RunWriter._add

    def counting(writer: RunWriter, *message: Any, **more: Any) -> None:
        add(writer, *message, **more)
        COUNTS.pack_into(counts, 0, writer.messages, writer.messages - writer._unflushed)

    RunWriter._add = counting  # type: ignore[method-assign, assignment]


def ended(pid: int) -> int | None:
    """The exit status once it has one (below zero for a signal), else None after a time that no command needs."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return None


def take(rig: Path, seed: int, taken: Path) -> int:
    """In a forked process: samples out of the IMU's FIFO, a burst or many; when [ns] and which goes to `taken`."""
    pid = os.fork()
    if pid:
        return pid
    status = 70
    try:
        device = load_rig(rig).devices.imu
        assert device is not None
        rng, bus, lines = np.random.default_rng((seed, 1)), open_bus(device.bus), []
        pauses = np.full(int(2 ** rng.uniform(0, 6)), rng.uniform(0.005, 0.1))
        for pause in pauses.tolist():
            before_ns = time.monotonic_ns()
            level = read_registers(bus, device.address, lsm9ds1_registers.FIFO_SRC, 1)[0] & lsm9ds1_registers.FIFO_FSS
            if level:
                size = level * lsm9ds1_registers.SAMPLE_BYTES
                data = read_registers(bus, device.address, lsm9ds1_registers.OUT_X_L_G, size)
                lines.append(f"{before_ns} {time.monotonic_ns()} {data.hex()}\n")
            time.sleep(pause)
        taken.write_text("".join(lines))
        status = 0
    finally:
        os._exit(status)


def unlatch(rig: Path) -> None:
    """Acknowledge the watchdog's fault that a kill leaves, as a person has to: no recording starts upon it."""
    device = load_rig(rig).devices.controller
    assert device is not None
    with suppress(DriverError), connect(device) as controller:
        controller.open()
        controller.clear_faults()
