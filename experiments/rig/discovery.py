"""`legid init --probe`: what is connected. Reads identities; the controller is greeted, stopped and never armed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import structs

from daq import ControllerDevice, InputError
from drivers import DriverError, I2CBus, drive_kinds, drive_rate_hz, find_nodes, open_bus, read_registers
from drivers import lsm9ds1_registers as reg
from experiments.rig import devices
from experiments.rig.writer import RigFacts

IMU_ADDRESSES = (0x6B, 0x6A)
MAG_ADDRESSES = (0x1E, 0x1C)
MAG_WHO_AM_I = 0x3D
"""Of the package's magnetometer, register 0x0F (datasheet, section 8)."""
HELLO_TIMEOUT_S = 1.0
CAN_TYPE = "280"
"""ARPHRD_CAN of linux/if_arp.h."""
NET = Path("/sys/class/net")
DEV = Path("/dev")


def i2c_buses() -> list[str]:
    """Buses of this machine."""
    return sorted(str(path) for path in DEV.glob("i2c-*"))


def serial_ports() -> list[str]:
    """USB serial ports of this machine: built-in ones may be a console or somebody's modem and are left alone."""
    return sorted(str(path) for kind in ("ttyACM*", "ttyUSB*") for path in DEV.glob(kind))


def can_channels() -> list[str]:
    """CAN interfaces of this machine."""
    return sorted(path.parent.name for path in NET.glob("*/type") if path.read_text().strip() == CAN_TYPE)


def probe(facts: RigFacts, say: Callable[[str], None], ports: Sequence[str] | None = None) -> RigFacts:
    """`facts` with what answered: the first LSM9DS1, the first leg controller. Each find and miss is said."""
    facts = _probe_imu(facts, say)
    places = [ControllerDevice(port=port) for port in (serial_ports() if ports is None else ports)]
    if ports is None:
        places += [ControllerDevice(can={"interface": "socketcan", "channel": name}) for name in can_channels()]
    for device in (choice for place in places for choice in drives_at(place)):
        place = device.port if device.can is None else str(device.can["channel"])
        try:
            with devices.connect(device) as controller:
                hello, words = controller.open(HELLO_TIMEOUT_S), controller.words
        except (DriverError, InputError) as error:
            say(f"{place}: {error}")
            continue
        if device.kind != "legid":
            say(f"{place}: a {device.kind}, node {device.node}: {words}")
            return replace(facts, port=None if device.can else place, can_channel=place if device.can else None,
                           kind=device.kind, node=device.node, rate_hz=device.rate_hz, known=facts.known | {"port"})
        say(f"{place}: a leg controller, gear {hello.gear_ratio:g}, at most {hello.torque_limit_nm:g} N m, "
            f"{hello.telemetry_hz} Hz")
        return replace(
            facts, port=None if device.can else place, can_channel=place if device.can else None,
            gear_ratio=hello.gear_ratio, torque_nm=hello.torque_limit_nm, rate_hz=float(hello.telemetry_hz),
            watchdog_ms=min(facts.watchdog_ms, hello.watchdog_ms),
            known=facts.known | {"port", "gear_ratio", "torque_nm", "rate_hz"})
    say(f"no leg controller answered on {', '.join(d.port for d in places if d.can is None) or 'any port'}")
    return facts


def drives_at(place: ControllerDevice) -> Iterator[ControllerDevice]:
    """Drives to greet there: our own firmware first, then every drive that answers to a look for it, by its node."""
    yield place
    for kind in drive_kinds():
        try:
            nodes = find_nodes(kind, devices.wiring(place))
        except DriverError:
            continue  # said already, of the same place
        rate_hz = drive_rate_hz(kind)
        yield from (structs.replace(place, kind=kind, node=node, rate_hz=rate_hz) for node in nodes)


def _probe_imu(facts: RigFacts, say: Callable[[str], None]) -> RigFacts:
    buses = i2c_buses()
    for path in buses:
        try:
            bus = open_bus(path)
        except DriverError as error:
            say(str(error))
            continue
        try:
            address = _first(bus, IMU_ADDRESSES, reg.WHO_AM_I_VALUE)
            if address is None:
                say(f"{path}: no LSM9DS1")
                continue
            magnetometer = _first(bus, MAG_ADDRESSES, MAG_WHO_AM_I)
        finally:
            bus.close()
        say(f"{path}: LSM9DS1 at 0x{address:02X}"
            + ("" if magnetometer is None else f", its magnetometer at 0x{magnetometer:02X}"))
        return replace(facts, bus=path, address=address, magnetometer=magnetometer, known=facts.known | {"bus"})
    if not buses:
        say("no I2C bus; enable I2C (raspi-config, dtparam=i2c_arm=on)")
    return facts


def _first(bus: I2CBus, addresses: Sequence[int], identity: int) -> int | None:
    """The first address whose WHO_AM_I reads so."""
    for address in addresses:
        try:
            if read_registers(bus, address, reg.WHO_AM_I, 1)[0] == identity:
                return address
        except OSError:
            continue
    return None
