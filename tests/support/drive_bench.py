"""A drive before its emulator on virtual time, with a leg or a joint held fast behind it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from drivers import Drive, FaultReport, Received, State, Telemetry, Wiring, attach
from drivers.mock import EmulatorLink, FirmwareSettings, MockRig, Plant, VirtualClock, drive_facts, drive_maker
from tests.support.still_plant import StillPlant

CONSTANT = 0.85


class DriveBench:
    """`drive` and `far`, its emulator."""

    def __init__(self, kind: str, plant: Plant | None = None, seed: int = 1, settings: FirmwareSettings | None = None,
                 **wiring: Any) -> None:
        self.kind, facts = kind, drive_facts(kind)
        self.wiring = replace(Wiring(node=facts.node, rate_hz=facts.rate_hz, gear_ratio=50.0, turns=-50.0,
                                     torque_constant_nm_per_a=CONSTANT), **wiring)
        self.clock = VirtualClock()
        settings = settings or FirmwareSettings(torque_constant_nm_per_a=CONSTANT)
        self.rig = MockRig(plant or StillPlant(), self.clock, firmware=settings, seed=seed,
                           make=drive_maker(kind, self.wiring))
        self.far: Any = self.rig.drive
        self.link = EmulatorLink(self.far, self.clock, seed=seed, nothing=getattr(self.far, "nothing", b""))
        self.drive = self.attached()

    def run(self, seconds: float, torque_nm: float | None = None) -> list[Received]:
        """Poll for so long, a torque commanded every 10 ms where one is given."""
        end, due, out = self.clock.now_ns() + round(seconds * 1e9), 0, []
        while self.clock.now_ns() < end:
            if torque_nm is not None and self.clock.now_ns() >= due:
                due = self.clock.now_ns() + 10_000_000
                self.drive.command(torque_nm)
            out += self.drive.poll()
        return out

    def armed(self, watchdog_ms: int = 100) -> None:
        """Open, arm, and wait for it."""
        if hasattr(self.far, "watchdog_s"):  # where it is a setting of the drive's
            self.far.watchdog_s = watchdog_ms * 1e-3
        self.drive.open()
        self.run(0.05)
        self.drive.arm(watchdog_ms)
        end = self.clock.now_ns() + round(self.drive.capabilities.arming_s * 1e9)
        while not self.drive.armed:
            self.run(0.01, 0.0)
            assert self.clock.now_ns() < end, f"did not arm: {self.drive.words}"

    def attached(self, **wiring: Any) -> Drive:
        """Another driver on the same link, its wiring changed so."""
        return attach(self.kind, self.link, replace(self.wiring, **wiring), self.clock.now_ns, self.clock.sleep)

    def alone(self, seconds: float) -> None:
        """The drive goes on for so long while nobody polls."""
        self.clock.sleep(seconds)
        self.far.transmit(self.clock.now_ns())

    def zero_after(self, since_ns: int) -> float:
        """Time [s] from `since_ns` until the drive asked the motor for nothing for the rest of the record."""
        t_ns, commanded, _ = self.far.record
        on = np.flatnonzero((np.abs(commanded) > 0.0) & (t_ns >= since_ns))
        return float(t_ns[on[-1]] - since_ns) * 1e-9 if on.size else 0.0


def opened(kind: str, plant: Plant | None = None, **wiring: Any) -> DriveBench:
    """With its devices open."""
    bench = DriveBench(kind, plant, **wiring)
    bench.drive.open()
    return bench


def driven(kind: str, watchdog_ms: int = 1000) -> DriveBench:
    """Armed, with a torque of 1 N m."""
    bench = DriveBench(kind)
    bench.armed(watchdog_ms)
    bench.run(0.05, 1.0)
    return bench


def telemetry(received: list[Received]) -> list[Telemetry]:
    """The samples among what came."""
    return [one.message for one in received if isinstance(one.message, Telemetry)]


def faults(received: list[Received]) -> list[FaultReport]:
    """The reports of faults among what came."""
    return [one.message for one in received if isinstance(one.message, FaultReport)]


def states(received: list[Received]) -> set[State]:
    """The states that they name."""
    return {State(one.state) for one in telemetry(received)}


def fed_in_pieces(packet: Callable[[int, int, bytes], bytes], decoder: Any) -> list[bytes]:
    """300 packets, which come out of the decoder whole however their stream is cut."""
    rng = np.random.default_rng(1)
    sent = [packet(int(rng.integers(253)), 0, rng.bytes(int(rng.integers(60)))) for _ in range(300)]
    stream, found = b"".join(sent), 0
    while stream:
        n = int(rng.integers(1, 40))
        found += len(decoder.feed(stream[:n]))
        stream = stream[n:]
    assert found == 300 and decoder.bad == 0
    return sent


def models_heard(bench: DriveBench, decoder: Any) -> list[tuple[int, int]]:
    """Identifiers and model numbers of servos that answer together."""
    return [(one.ident, int.from_bytes(one.params, "little"))
            for _ in range(5) for one in decoder.feed(bench.link.read())]
