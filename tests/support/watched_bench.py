"""A recording on virtual time that somebody watches."""

import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from daq.recording import ALIVE, PACKET_BYTES, Ended, Heard, Plan, Remote, Status, watched_by
from daq.runs import read_run
from tests.support.virtual_rig import VirtualRig

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.imu]\n[devices.controller]\n'


class Bench(VirtualRig):
    """A recording on virtual time with a watcher at the other end of the line."""

    def __init__(self, folder: Path, seconds: float = 2.0) -> None:
        super().__init__()
        self.open()
        t = np.arange(0.0, seconds, 0.01)
        self.plan = Plan(t, np.full(t.size, 0.4))
        folder.mkdir(exist_ok=True)
        self.path = folder / "run.mcap"
        self.watcher, self.line = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.watcher.setblocking(False)
        self.packets: list[Status | Heard | Ended] = []

    def ramped(self) -> bool:
        """Whether the torque passed through values between the plan's and zero."""
        commanded = read_run(self.path).streams["/leg/command"]["torque_nm"]
        return bool(((commanded > 0) & (commanded < 0.4)).any())

    def record(self, happens: Callable[[float, Remote], None] = lambda now_s, remote: None) -> None:
        """Under `watched_by`, as the command does it; `happens` is called before every command of the plan."""
        descriptor = self.line.detach()
        self.beating = True
        threading.Thread(target=self._beat, daemon=True).start()
        with watched_by(descriptor) as remote:
            assert remote is not None

            self.save(self.path, RIG, self.plan, progress=lambda now_s, _: happens(now_s, remote), remote=remote)

    def _beat(self) -> None:
        with suppress(OSError):  # a test may have closed it
            while True:
                if self.beating:
                    with suppress(BlockingIOError):
                        self.watcher.send(ALIVE)
                if self.beating:
                    self.beat_ns = time.monotonic_ns()
                time.sleep(0.02)

    def read(self) -> list[Status | Heard | Ended]:
        """Everything that the watcher was told."""
        while True:
            try:
                packet = self.watcher.recv(PACKET_BYTES)
            except BlockingIOError:
                packet = b""
            if not packet:
                return self.packets
            self.packets.append(msgspec.json.decode(packet, type=Status | Heard | Ended))
