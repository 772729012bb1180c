"""`Drive`: what recorder, supervisor, doctor, dashboard and calibration ask of whatever turns the knee.

One file a drive, found by its name: `[devices.controller] kind = "moteus"` is `drivers/moteus_drive.py`. It has two
functions: `open_link(wiring)` gives the transport, `attach(link, wiring, now_ns, sleep)` the drive behind it, not yet
greeted. Our own firmware is `drivers/legid_drive.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, Self

from drivers.errors import DeviceAbsent
from drivers.link import Link
from drivers.protocol import DriveLimits, Hello, Message, Telemetry

SUFFIX = "_drive"


class Received(NamedTuple):
    """A message and the host time at which the read that brought it returned [ns]."""

    message: Message
    host_ns: int
    asked_ns: int | None = None
    """Host time just before the request was written that this answers [ns]; None: it came unasked."""


@dataclass(frozen=True)
class LinkStats:
    """Counts since the drive object was made."""

    bad_crc: int
    bad_length: int
    unknown: int
    lost: int
    reboots: int


class Lack(NamedTuple):
    """Something that our own firmware does and this drive does not."""

    what: str
    instead: str
    """What takes its place."""


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a drive; the defaults are those of legid's firmware."""

    polled: bool = False
    """Telemetry answers a request: a sample was taken between request and reply, by the host's clock. Otherwise it
    comes unasked and carries the drive's own tick."""
    clock: Literal["tick", "counter", "none"] = "tick"
    """The drive's own clock: one that times samples, one that only shows that the firmware runs, or none."""
    current: Literal["mean", "instant"] = "mean"
    """The current is the mean since the sample before, or the one at the sample."""
    knee_twice: bool = True
    """It reads the knee's angle by a second sensor."""
    hip: bool = True
    """It reads the pivot's angle."""
    arming_s: float = 0.5
    """Longest time from `arm` to ARMED [s]."""
    lacks: tuple[Lack, ...] = ()


class Drive(Protocol):
    """One drive. `poll` belongs to one reader thread; the commands may come from any thread.

    Torque is zero after `open`, `stop` and `close`, and after a fault; only `arm` and then `command` change that.
    """

    @property
    def hello(self) -> Hello | None:
        """Version and boot of the drive: what `open` returned, or a later boot's. A drive that counts no boots draws
        the number."""

    @property
    def telemetry(self) -> Telemetry | None:
        """The newest telemetry seen."""

    @property
    def limits(self) -> DriveLimits | None:
        """Limits that the drive itself checks; None where it does not say."""

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities of the drive."""

    @property
    def words(self) -> str:
        """The drive's state in its maker's words, for a person: an error code, a version; empty where none."""

    @property
    def refusal(self) -> str:
        """Why `arm` would refuse by the drive's settings, with the remedy; empty where it would not."""

    @property
    def armed(self) -> bool:
        """The newest telemetry says ARMED."""

    @property
    def link_facts(self) -> dict[str, str | int | None]:
        """Facts about the link: its kind, port, latency timer."""

    @property
    def stats(self) -> LinkStats:
        """Counts so far."""

    def open(self, timeout_s: float = 2.0) -> Hello:
        """Stop the motor, identify the drive. Raises `DeviceAbsent` (no answer), `ProtocolMismatch` (a version that
        this program does not speak) or `DeviceFault`; all close."""

    def poll(self) -> list[Received]:
        """Messages since the last call, with time stamps; waits a little for them. A polled drive is asked here, at its
        rate.

        Raises `LinkLost`, `ProtocolMismatch`."""

    def arm(self, watchdog_ms: int) -> None:
        """Ask for ARMED with the drive's own watchdog; telemetry says within `capabilities.arming_s` if it was
        granted. Raises `DeviceFault` where a fault is latched or the watchdog would not turn torque off, ValueError
        where it cannot be that long."""

    def command(self, torque_nm: float) -> int:
        """Ask for a joint torque [N m] and feed the drive's watchdog, which nothing else feeds; returns a running
        number. One that is not finite or beyond the drive's limit stops the motor and raises `DriverError`."""

    def ping(self) -> tuple[int, int] | None:
        """Send a clock probe: its id and the host time just before it was written [ns]. None: every sample is one."""

    def stop(self) -> None:
        """Torque zero and disarm, in every state."""

    def clear_faults(self) -> None:
        """Stop, then have latched faults forgotten; the telemetry that follows says if they were."""

    def close(self) -> None:
        """Stop the motor, then let go of the link; may be called twice."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...


def hello_of(controller: Drive) -> Hello:
    """Version and boot of the drive that answers. Raises ValueError where the drive has not been opened."""
    if controller.hello is None:
        raise ValueError("open the leg controller first")
    return controller.hello


@dataclass(frozen=True)
class Wiring:
    """Place of a drive and its mounting on the joint; all that a driver is told of a rig file."""

    port: str = "/dev/ttyACM0"
    baud: int = 1_000_000
    can: Mapping[str, Any] | None = None
    """python-can's configuration; given, `port` and `baud` are not used."""
    node: int = 0
    rate_hz: float = 500.0
    """Rate at which a polled drive is asked."""
    gear_ratio: float = 1.0
    """Turns of the motor per turn of the joint."""
    turns: float = 1.0
    """Turns that the drive counts per turn of the joint, signed: `gear_ratio` where it sits on the motor, 1 where on
    the joint."""
    torque_constant_nm_per_a: float = 1.0
    """Joint torque per ampere, gear included."""
    torque_limit_nm: float = 2.0
    """The joint's limit in the rig file."""
    speed_limit_radps: float = 15.0
    """The joint's limit in the rig file."""
    watchdog_ms: int = 100
    """The drive's watchdog in the rig file."""


def drive_kinds() -> list[str]:
    """All kinds of drives: one file `KIND_drive.py` each in this folder."""
    return sorted(path.stem.removesuffix(SUFFIX) for path in Path(__file__).parent.glob(f"*?{SUFFIX}.py"))


def drive_module(kind: str) -> Any:
    """The module of a kind of drive. Raises `DeviceAbsent` where there is none."""
    module = f"{__package__}.{kind}{SUFFIX}"
    if not kind.isidentifier() or find_spec(module) is None:
        raise DeviceAbsent(f"[devices.controller] kind: no driver knows {kind}; there are {', '.join(drive_kinds())}, "
                           f"and yours is drivers/{kind}{SUFFIX}.py")
    return import_module(module)


def attach(kind: str, link: Link[Any], wiring: Wiring, now_ns: Callable[[], int] = time.monotonic_ns,
           sleep: Callable[[float], None] = time.sleep) -> Drive:
    """The drive behind a link, on any clock, not yet greeted."""
    drive: Drive = drive_module(kind).attach(link, wiring, now_ns, sleep)
    return drive


def find_nodes(kind: str, wiring: Wiring) -> list[int]:
    """Nodes of drives of this kind that are there, by the module's `find_nodes(link, wiring)`; none where it has no
    such function, or where the place is not one for it. Motors that answer are stopped. Raises a `DriverError`."""
    module = drive_module(kind)
    find = getattr(module, "find_nodes", None)
    if find is None:
        return []
    link = module.open_link(wiring)
    try:
        found: list[int] = find(link, wiring)
        return found
    finally:
        link.close()


def drive_rate_hz(kind: str) -> float:
    """Default polling rate of a drive of this kind [Hz]: the module's RATE_HZ."""
    return float(getattr(drive_module(kind), "RATE_HZ", 250.0))


def open_drive(kind: str, wiring: Wiring) -> Drive:
    """The drive at the end of its wiring, not yet greeted. Raises a `DriverError`."""
    return attach(kind, drive_module(kind).open_link(wiring), wiring)
