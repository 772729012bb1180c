"""`legid doctor` on an emulated rig over a real pseudo-terminal, whole and with one thing wrong at a time."""

import errno
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq import ControllerDevice, Rig
from drivers import DeviceAbsent, open_bus
from drivers.mock import FirmwareSettings, MockRig, PtyServer
from drivers.protocol import Fault
from drivers.serial_link import SerialLink
from experiments.doctor import bus, link, preflight
from tests.support.device_faults import FaultyDisk, FaultyWire, WireFaults
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Shell
from tests.support.still_plant import MovingPlant, StillPlant, StillState

pytestmark = REAL_CLOCK

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[motor]
gear_ratio = 50.0
[devices.imu]
bus_khz = 400.0
rate_hz = 59.5
[devices.controller]
port = "{port}"
rate_hz = 200
[limits]
torque_nm = 2.0
clock_bound_s = {bound}
[calibration]
shunt_offset_a = 0.031
"""


def by_hand(t: float) -> StillState:
    """Both joints swung by hand: the motion is written down, not simulated."""
    a, w = 0.5, 2 * math.pi * 0.7
    c, s = math.cos(w * t), math.sin(w * t)
    return StillState(a * s, 0.8 * a * (1 - c), a * w * c, 0.8 * a * w * s, -a * w * w * s)


@dataclass
class Bench:
    """An emulated rig in real time, and its rig file."""

    mock: MockRig
    rig: Path
    shell: Shell

    def check(self, *more: str, status: int = 0) -> dict[str, str]:
        """Check -> its line."""
        self.shell("doctor --rig", self.rig, "--out", self.rig.parent, *more, status=status)
        return lines(self.shell.out)

    def fails(self, name: str, *more: str) -> str:
        """What this check, which alone fails, says of it."""
        found = self.check(*more, status=1)
        assert failing(found) == {name}
        return found[name]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preflight, "LISTEN_S", 0.7)


def settings(**changes: float) -> FirmwareSettings:
    return FirmwareSettings(**{"telemetry_hz": 200, "shunt_offset_a": 0.031, **changes})  # type: ignore[arg-type]


def replace_bus(monkeypatch: pytest.MonkeyPatch, opened: Callable[[str], Any]) -> None:
    monkeypatch.setattr("experiments.rig.devices.open_bus", opened)
    monkeypatch.setattr("experiments.doctor.bus.open_bus", opened)


@pytest.fixture
def serve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> Iterator[Callable[..., Bench]]:
    with ExitStack() as stack:
        def served(plant: Any = None, bound: float = 5.0, bus_khz: float = 400.0, **firmware: float) -> Bench:
            mock = MockRig(plant or StillPlant(), firmware=settings(**firmware), bus_khz=bus_khz)
            replace_bus(monkeypatch, lambda path: mock.imu)
            port = stack.enter_context(PtyServer(mock.firmware, mock.clock))
            rig = tmp_path / "rig.toml"
            rig.write_text(RIG.format(port=port.path, bound=bound))
            return Bench(mock, rig, shell)

        yield served


@pytest.fixture
def bench(serve: Callable[..., Bench]) -> Bench:
    return serve()


@pytest.fixture
def swung(serve: Callable[..., Bench]) -> Bench:
    return serve(MovingPlant(by_hand))


def lines(out: str) -> dict[str, str]:
    rows = [line for line in out.splitlines() if line[:4] in ("ok  ", "warn", "FAIL")]
    return {row[6:].split("  ")[0]: row for row in rows}


def failing(found: dict[str, str]) -> set[str]:
    return {name for name, line in found.items() if line.startswith("FAIL")}


def test_a_good_rig_passes_every_check(bench: Bench) -> None:
    found = bench.check()
    assert set(found) >= {"serial permissions", "exclusive use", "firmware version", "firmware settings",
                          "latency timer", "drive", "I2C bus", "kernel driver", "chip identity", "I2C speed",
                          "IMU settings", "telemetry", "clock bound", "shunt zero", "IMU samples", "gyro bias",
                          "gravity", "disk space", "disk speed"}
    assert bench.mock.firmware.drive.torque_nm == 0.0


def test_faults_on_the_bus(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver, chip = (tmp_path / "sys/bus/i2c" / name for name in ("drivers/st_lsm9ds1", "devices/1-006b"))
    for folder in (driver, chip):
        folder.mkdir(parents=True)
    (chip / "driver").symlink_to(driver)
    monkeypatch.setattr(bus, "SYSFS", tmp_path / "sys")
    bench.mock.imu.fail(errno.EBUSY)
    assert "bound: st_lsm9ds1; echo 1-006b | sudo tee" in bench.fails("kernel driver")
    bench.mock.imu.fail(errno.EREMOTEIO)
    assert "pull-ups" in bench.fails("chip identity")


def test_another_chip_and_no_bus(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    class OtherChip:
        """Answers every read with 0x3D, the magnetometer's identity."""

        def i2c_rdwr(self, *messages: Any) -> None:
            for message in messages:
                if message.flags & 1:
                    for k in range(message.len):
                        message.buf[k] = b"\x3d"

        def close(self) -> None:
            return

    replace_bus(monkeypatch, lambda path: OtherChip())
    assert "0x3D" in bench.fails("chip identity")
    replace_bus(monkeypatch, open_bus)
    bench.rig.write_text(bench.rig.read_text().replace("bus_khz", 'bus = "/dev/i2c-nowhere"\nbus_khz'))
    assert "enable I2C" in bench.fails("I2C bus")


@pytest.mark.parametrize("khz, status", [(30.0, "FAIL"), (100.0, "warn")])
def test_a_slow_bus_is_measured(khz: float, status: str, serve: Callable[..., Bench]) -> None:
    bench = serve(bus_khz=khz)
    bench.rig.write_text(bench.rig.read_text().replace("59.5", "238.0" if khz < 100 else "59.5"))
    line = bench.check(status=int(status == "FAIL"))["I2C speed"]
    assert line.startswith(status) and "i2c_arm_baudrate=400000" in line
    assert float(line.split()[3]) <= 1.01 * khz


def test_the_port_in_other_hands_or_missing(bench: Bench) -> None:
    port = bench.rig.read_text().split('port = "')[1].split('"')[0]
    child = subprocess.Popen([sys.executable, "-c", f"f = open({port!r}, 'rb'); print(flush=True); input()"],
                             stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    child.stdout.readline()
    try:
        assert f"({child.pid})" in bench.fails("exclusive use")
    finally:
        child.communicate(b"\n")
    bench.rig.write_text(bench.rig.read_text().replace(port, "/dev/ttyNowhere"))
    bench.shell("doctor --rig", bench.rig, "--out", bench.rig.parent, status=1)
    out, err = bench.shell.read()
    assert "no such port; plug the controller in" in out
    assert err.count("\n") == 1 and "checks failed: controller" in err


def test_latency_timer(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SerialLink, "latency_timer_ms", property(lambda self: 16))
    assert "16 ms; echo 1 | sudo tee" in bench.fails("latency timer")


@pytest.mark.parametrize("firmware, check, words", [
    ({"shunt_offset_a": 0.08}, "shunt zero", "shunt_offset_a = 0.0"),
    ({"gear_ratio": 30.0}, "firmware settings", "gear_ratio is 50, the firmware's 30"),
    ({"torque_limit_nm": 1.0}, "firmware settings", "torque_nm is 2, the firmware's 1"),
    ({"version": 2}, "controller", "flash matching firmware"),
])
def test_firmware(firmware: dict[str, float], check: str, words: str, serve: Callable[..., Bench]) -> None:
    assert words in serve(**firmware).fails(check)


def test_a_latched_fault(bench: Bench) -> None:
    bench.mock.firmware.drive.trip(Fault.OVERTEMPERATURE, 95.0)
    found = bench.check(status=1)["drive"]
    assert "overtemperature; let the motor cool" in found and "then legid doctor --clear-faults --rig RIG" in found
    assert "no fault" in bench.check("--clear-faults")["drive"]
    bench.mock.firmware.gate_driver_ok = False
    assert "gate" in bench.check("--clear-faults", status=1)["drive"]  # its cause is still there


def test_a_clock_bound_that_is_not_met(serve: Callable[..., Bench]) -> None:
    serve(bound=1e-6).fails("clock bound")


def test_a_bad_cable_is_seen(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    wire = FaultyWire(WireFaults(flip=0.1), np.random.default_rng(0))
    inner = bench.mock.firmware.transmit
    monkeypatch.setattr(bench.mock.firmware, "transmit",
                        lambda until_ns: [(t, b"".join(wire.pass_on(data))) for t, data in inner(until_ns)])
    found = bench.check(status=1)["telemetry"]
    assert found.startswith("FAIL") and "check cable" in found


@pytest.mark.parametrize("room, delay, words", [
    (1 << 20, 0.0, "No space left"), (float("inf"), 0.17, "record to a faster disk")])
def test_disk(room: float, delay: float, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preflight, "DISK_BYTES", 2 << 20 if delay == 0 else 2 << 16)
    monkeypatch.setattr(preflight, "open_scratch", lambda path: Disk(path.open("xb"), delay, room))
    space, speed = preflight.check_disk(tmp_path)
    assert (space.status, speed.status) == ("ok", "FAIL") and words in speed.words
    assert list(tmp_path.iterdir()) == []


class Disk(FaultyDisk):
    """A `FaultyDisk` in a with statement."""

    def __enter__(self) -> "Disk":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def test_a_leg_swung_by_hand_agrees(swung: Bench) -> None:
    found = swung.check("--move 2.5")
    for name in ("knee encoder", "gyro", "accelerometer x", "accelerometer y"):
        scale = float(found[name].split("scale ")[1].split(";")[0])
        assert scale == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("mount, check", [
    ("[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "gyro"),
    ("[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]", "accelerometer x"),
    ("[[1, 0, 0], [0, -1, 0], [0, 0, 1]]", "accelerometer y"),
])
def test_a_turned_mount_is_found(mount: str, check: str, swung: Bench) -> None:
    swung.rig.write_text(swung.rig.read_text() + f"imu_mount = {mount}\n")
    assert "sign is WRONG" in swung.fails(check, "--move 1.6")


def test_a_leg_that_was_not_moved(bench: Bench) -> None:
    assert "not moved enough" in bench.check("--move 2", status=1)["gyro"]
    bench.check("--move 0", status=2)


IP = """#!/bin/sh
echo '[{"ifname":"can0","flags":[%s],"operstate":"UP","linkinfo":{"info_kind":"can","info_data":{"state":"%s",
"berr_counter":{"tx":0,"rx":0},"bittiming":{"bitrate":%d,"sample_point":"0.875"}}}}]'
"""


@pytest.mark.parametrize("flags, state, bitrate, status, words", [
    ('"NOARP","UP","ECHO"', "ERROR-ACTIVE", 1000000, "ok", "error-active, 1000000 bit/s"),
    ('"NOARP","ECHO"', "STOPPED", 1000000, "FAIL", "is down; sudo ip link set can0 up type can bitrate 1000000"),
    ('"NOARP","UP","ECHO"', "ERROR-ACTIVE", 500000, "FAIL", "500000 bit/s, the rig says 1000000"),
    ('"NOARP","UP","ECHO"', "BUS-OFF", 1000000, "FAIL", "check wiring"),
    ('"NOARP","UP","ECHO"', "ERROR-PASSIVE", 1000000, "warn", "termination"),
])
def test_can_interface(flags: str, state: str, bitrate: int, status: str, words: str, tmp_path: Path,
                       monkeypatch: pytest.MonkeyPatch) -> None:
    tool = tmp_path / "ip"
    tool.write_text(IP % (flags, state, bitrate))
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    found = link.can_interface("can0", {"interface": "socketcan", "channel": "can0", "bitrate": 1_000_000})
    assert found.status == status and words in found.words
    assert "no such interface" in link.can_interface("can7", {}).words


def test_without_a_rig_file_the_usual_places_are_looked_at(here: Path, monkeypatch: pytest.MonkeyPatch,
                                                           shell: Shell) -> None:
    def nobody(device: ControllerDevice, rig: Rig | None) -> None:
        raise DeviceAbsent(f"leg controller on {device.port}: no such port")

    monkeypatch.setattr("experiments.rig.devices.connect", nobody)
    replace_bus(monkeypatch, lambda path: open_bus(path + "-nowhere"))
    shell("doctor --out nowhere", status=1)
    found = lines(shell.out)
    assert failing(found) >= {"controller", "I2C bus", "disk space"}
    assert "/dev/ttyACM0" in found["controller"]
    assert "/dev/i2c-1-nowhere" in found["I2C bus"]
    assert "--out" in found["disk space"]


def test_a_drive_that_is_never_armed_is_said_to_be_so() -> None:
    from daq.rig import parse_rig
    from tests.support.drive_bench import DriveBench

    far = DriveBench("feetech")
    far.drive.open()
    rig = parse_rig('[mechanism]\nmodel = "leg2"\nactuated = [2]\n[limits]\nunchecked = ["encoder_s"]\n')
    found = link._drive_alone(far.drive, rig)
    assert [one.status for one in found if one.name == "drive's watchdog"] == ["FAIL"]
    assert not any(one.name == "drive's limits" for one in found)
