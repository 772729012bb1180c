"""Faults by counting: the Nth write, flush, sync, read or allocation of a recording on virtual time fails, for every N.

One recording goes on undisturbed. At each operation it is forked: in the copy that operation fails, and the copy
records to its end with a file of its own. So every N costs the end of a recording, not a whole one.
"""

import errno
import json
import math
import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from daq import InputError, WorkError, parse_rig
from daq.recording import Plan, record
from daq.runs import RunWriter, mcap_run, read_run
from drivers import DriverError, ImuConfig, LinkLost, Lsm9ds1
from evidence.drive_faults import RIG as DRIVE_RIG
from evidence.drive_faults import DriveFaultBench
from tests.support.fault_bench import RIG, FaultBench
from tests.support.spies import before

RECORD: Any = record
RUNS: Any = mcap_run
SYSTEM: Any = os
"""Modules of which a function is replaced."""
DRIVES = ("legid", "moteus", "odrive", "dynamixel")
SECONDS, AFTER_S = 2.0, 0.4
EIO = OSError(errno.EIO, os.strerror(errno.EIO))
FAULTS: dict[str, tuple[BaseException, str]] = {
    "write": (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), "No space left on device"),
    "flush": (EIO, "Input/output error"), "sync": (EIO, "Input/output error"),
    "read of the link": (LinkLost("leg controller: read failed (Input/output error); check the cable"),
                         "Input/output error"),
    "read of the IMU": (OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO)), "no acknowledge"),
    "allocation": (MemoryError(), "memory")}
"""What fails -> how, and the words that name it."""


class Ended(NamedTuple):
    """How a recording ended whose operation failed."""

    drive: str
    kind: str
    number: int
    zero_ms: float
    """From the fault to the last torque asked of the motor; 0 where none was any more, or the recording went on."""
    said: str
    readable: bool
    """The file holds every message that was flushed before."""
    named: bool
    """The message names the cause, or the recording went on without harm."""


class NthBench:
    """One recording of 2 s that is forked at the operations of `wanted`: (kind, number) -> whether."""

    def __init__(self, drive: str, wanted: Callable[[str, int], bool], folder: Path) -> None:
        self.drive, self._wanted, self.folder = drive, wanted, folder
        self.counts: Counter[str] = Counter()
        self.found: list[Ended] = []
        self.path = folder / f"{drive}.mcap"
        self._child: tuple[str, int] | None = None
        self._answer = -1
        self._flushed = self._kept = 0
        self._writer: RunWriter | None = None
        self._struck_ns = 0
        self._busy = False
        self._controller: Any
        if drive == "legid":
            own = FaultBench(lambda bench: None, "never")
            self.clock, link, bus, self._controller = own.clock, own.link, own.bus, own.controller
            self._far, self._record, self._imu = own.firmware, own.firmware.motor, own.imu
            self._text = RIG + "[limits]\n"
        else:
            bought = DriveFaultBench(drive, lambda bench: None, "never")
            self.clock, link, bus, self._controller = bought.clock, bought.wire, bought.bus, bought.drive
            self._far, self._record, self._text = bought.far, bought.far, DRIVE_RIG
            self._imu = Lsm9ds1(bus, config=ImuConfig(238.0), now_ns=self.clock.now_ns, sleep=self.clock.sleep)
            self._controller.open()
            self._imu.open()
        before(link, "read", lambda: self._operation("read of the link"))
        before(bus, "i2c_rdwr", lambda *_: self._operation("read of the IMU"))

    def _operation(self, kind: str) -> None:
        """Count one; where it is wanted, fail in a copy of this process."""
        if self._child is not None or self._writer is None or self._busy:
            return
        self.counts[kind] += 1
        number = self.counts[kind]
        if not self._wanted(kind, number):
            return
        ours, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(ours)
            self._child, self._answer, self._struck_ns = (kind, number), theirs, self.clock.now_ns()
            self._kept = self._flushed
            self._move_file()
            raise FAULTS[kind][0]
        os.close(theirs)
        with open(ours, "rb") as pipe:
            text = pipe.read()
        os.waitpid(child, 0)
        if not text:
            raise AssertionError(f"{self.drive}, {kind} {number}: the copy ended without an answer")
        self.found.append(Ended(*json.loads(text)))

    def _move_file(self) -> None:
        """A file of the copy's own behind the same descriptor."""
        assert self._writer is not None
        path = self.folder / f"{self.drive}-{os.getpid()}.mcap"
        shutil.copyfile(self._writer.path, path)
        file = self._writer._file
        descriptor = os.open(path, os.O_RDWR)
        os.lseek(descriptor, os.lseek(file.fileno(), 0, os.SEEK_CUR), os.SEEK_SET)
        os.dup2(descriptor, file.fileno())
        os.close(descriptor)
        self._writer.path = self.path = path

    def run(self) -> None:
        """Record; `found` has one entry for each operation that was wanted."""
        times = np.arange(0.0, SECONDS, 0.01)
        plan = Plan(times, 0.4 * np.sin(2 * np.pi * 1.3 * times))
        said, bench = "", self

        class Counted(RunWriter):
            def _begin(self, files: Any, facts: Any) -> None:
                bench._writer = self
                super()._begin(files, facts)

            def _add(self, *args: Any, **kwargs: Any) -> None:
                bench._operation("allocation")
                super()._add(*args, **kwargs)
                if not self._unflushed:
                    bench._flushed = self.messages

        create, sync = mcap_run._create, os.fdatasync
        before(os, "fdatasync", lambda _: self._operation("sync"))
        RUNS._create = lambda path: CountedFile(create(path), self)
        RUNS.time = SimpleNamespace(monotonic=lambda: 1e-9 * self.clock.now_ns(), time_ns=time.time_ns)  # of its syncs
        RECORD.RunWriter = Counted
        try:
            record.record_run(self.path, parse_rig(self._text), self._text, plan, self._imu, self._controller,
                                self.clock.now_ns, threaded=False)
        except (WorkError, DriverError) as error:
            said = str(error)
        except BaseException as error:
            said = f"internal error: {error!r}"
        finally:
            RUNS._create, SYSTEM.fdatasync, RECORD.RunWriter, RUNS.time = create, sync, RunWriter, time
        if self._child is not None:
            self._answer_and_end(said)
        if said:
            raise AssertionError(f"{self.drive}: the undisturbed recording ended early: {said}")

    def _answer_and_end(self, said: str) -> None:
        """Of a copy: let the rig run on alone, look at torque and file, tell the parent."""
        assert self._child is not None
        kind, number = self._child
        try:
            with suppress(DriverError):
                self._controller.close()
            self.clock.sleep(AFTER_S)
            self._far.transmit(self.clock.now_ns())
            t_ns, commanded, _ = self._record.record
            late = t_ns[(commanded != 0.0) & (t_ns >= self._struck_ns)]
            zero_ms = float(late[-1] - self._struck_ns) * 1e-6 if late.size and said else 0.0
            if late.size and late[-1] > self.clock.now_ns() - 0.1e9:
                zero_ms = math.inf
            held = 0
            with suppress(InputError):
                held = read_run(self.path).messages
            ended = Ended(self.drive, kind, number, zero_ms, said, held >= self._kept, FAULTS[kind][1] in said
                          or (not said and kind.startswith("read")))
            os.write(self._answer, json.dumps(ended).encode())
            self.path.unlink(missing_ok=True)
        finally:
            os._exit(0)


class CountedFile:
    """The run's file, whose writes and flushes are counted."""

    def __init__(self, file: Any, bench: NthBench) -> None:
        self._file, self._bench = file, bench

    def write(self, data: Any) -> int:
        """Of the real file, unless it is its turn to fail."""
        self._bench._operation("write")
        return int(self._file.write(data))

    def flush(self) -> None:
        """The same."""
        self._bench._operation("flush")
        self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def strike(drive: str, wanted: Callable[[str, int], bool], folder: Path) -> tuple[Sequence[Ended], Counter[str]]:
    """How every wanted operation ended, and how many of each kind there are."""
    bench = NthBench(drive, wanted, folder)
    bench.run()
    return bench.found, bench.counts
