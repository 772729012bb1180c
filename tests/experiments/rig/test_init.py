"""`legid init`: a rig file by asking and by probing, which the other commands take."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from daq import load_rig
from drivers import drive_rate_hz, i2c_bus
from drivers.mock import FirmwareSettings, MockRig, PtyServer
from experiments.doctor import preflight
from experiments.rig import discovery
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Answers, Shell
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.toml"


def test_by_asking(path: Path, answers: Answers, shell: Shell) -> None:
    asked = answers("", "", "9.8101", "wide", "0.17", "", "50", "legid", "/dev/ttyUSB3", "0.85", "1000", "-1", "1.5",
                    "12", "", "2.2")
    shell("init", path)
    rig = load_rig(path)
    body = rig.mechanism
    assert (body.model, body.actuated, body.gravity_mps2) == ("leg2", (2,), 9.8101)
    assert rig.imus[0].lever_arm_m == 0.17  # asked twice: `wide` is no number
    assert rig.devices.imu.bus == "/dev/i2c-1"
    assert rig.motor.gear_ratio == 50.0
    assert rig.calibration.torque_constant_nm_per_a == 0.85
    assert (rig.devices.controller.port, rig.devices.controller.rate_hz) == ("/dev/ttyUSB3", 1000.0)
    limits = rig.limits
    assert (limits.torque_nm, limits.speed_radps, limits.q1_rad, limits.q2_rad) == (1.5, 12.0, 1.6, 2.2)
    out = shell.out
    assert "wide is not a number" in out and "-1 is not a number" in out
    assert "[0.2]" in asked[3] and asked[3] == asked[4]
    text = path.read_text()
    assert "pivot to IMU along link 1 [m]\n" in text  # given, hence not marked
    assert text.count("ASSUMED, please measure") == 4  # knee zero, shunt offset, mount; Enter kept the hip's limit
    assert next(line for line in text.splitlines() if line.startswith("q1_rad")).endswith("ASSUMED, please measure")


def test_files_alone_need_no_devices_and_no_limits(path: Path, answers: Answers,
                                                   shell: Shell) -> None:
    asked = answers("", "", "", "0.17", "none", "50", "none")
    shell("init", path)
    rig, text = load_rig(path), path.read_text()
    assert len(asked) == 7 and rig.devices.controller is None and rig.devices.imu is None
    assert rig.imus[0].lever_arm_m == 0.17 and rig.motor.gear_ratio == 50.0
    assert "ASSUMED, please" not in text and "[limits]\n" not in text and "doctor" not in text
    assert "rig.toml: written. Next: legid import FILE..., then legid fit" in shell.out


def test_a_chain_on_can(path: Path, answers: Answers, shell: Shell) -> None:
    answers("pendulum", "chain", "3", "2,3", "", "20", "", "can0", "5", "", "", "", "", "", "")
    shell("init", path)
    rig = load_rig(path)
    assert (rig.mechanism.model, rig.mechanism.links, rig.mechanism.actuated) == ("chain", 3, (2, 3))
    controller = rig.devices.controller
    assert (controller.can, controller.node) == ({"interface": "socketcan", "channel": "can0"}, 5)
    assert rig.devices.imu is None


def test_a_moteus_by_asking(path: Path, answers: Answers, shell: Shell) -> None:
    answers("", "", "", "0.2", "", "6", "motor", "moteus", "moteus", "/dev/fdcanusb", "3", "0.5", "", "2", "", "", "")
    shell("init", path)
    controller, text, out = load_rig(path).devices.controller, path.read_text(), shell.out
    assert (controller.kind, controller.port, controller.node) == ("moteus", "/dev/fdcanusb", 3)
    assert controller.rate_hz == drive_rate_hz("moteus")
    assert "motor is none of" in out and "moteus is no place: give a serial port" in out
    marked = {line.split()[0] for line in text.splitlines() if line.endswith("ASSUMED, please measure")}
    assert {"speed_radps", "q1_rad", "q2_rad", "rate_hz", "side", "sign"} <= marked
    assert not {"torque_nm", "gear_ratio", "torque_constant_nm_per_a", "lever_arm_m"} & marked


def test_a_single_joint_has_no_second_limit(path: Path, answers: Answers, shell: Shell) -> None:
    asked = answers("joint1", "", "", "9", "odrive", "can0", "1", "0.4", "", "", "", "")
    shell("init", path)
    assert not any("second joint" in question for question in asked)
    assert load_rig(path).motor.gear_ratio == 9.0


def test_what_exists_is_left_alone(path: Path, answers: Answers, shell: Shell) -> None:
    path.write_text("mine")
    asked = answers()
    for how in ("", "--defaults", "--probe"):
        assert "exists already" in shell.fails("init", path, how)
    assert path.read_text() == "mine"
    assert not asked  # refused before anybody answers anything


def test_answers_that_end_early_or_do_not_fit(path: Path, answers: Answers, shell: Shell) -> None:
    answers("leg2", "2")
    assert "end before the questions" in shell.fails("init", path)
    answers("", "7", *[""] * 13)  # leg2 has no joint 7
    shell.fails("init", path)
    shell.fails("init", path, "--port /dev/x")
    shell.fails("init", path.parent / "no/rig.toml", "--defaults")
    assert not path.exists()


def test_defaults_are_a_rig(path: Path, shell: Shell) -> None:
    shell("init", path, "--defaults")
    rig = load_rig(path)
    assert rig.devices.imu is not None and rig.devices.controller is not None
    assert "lever_arm_m = 0.2" in path.read_text() and path.read_text().count("ASSUMED, please measure") >= 9


@pytest.fixture
def mock() -> Iterator[tuple[MockRig, str]]:
    """An emulated rig whose chip is at 0x6A, and its port."""
    firmware = FirmwareSettings(telemetry_hz=250, gear_ratio=36.0, torque_limit_nm=1.25)
    rig = MockRig(StillPlant(), firmware=firmware, address=0x6A)
    with PtyServer(rig.firmware, rig.clock) as server:
        yield rig, server.path


def test_by_probing(mock: tuple[MockRig, str], path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    rig_mock, port = mock
    monkeypatch.setattr(discovery, "i2c_buses", lambda: ["/dev/i2c-nowhere", "/dev/i2c-7"])
    monkeypatch.setattr(discovery, "serial_ports", lambda: ["/dev/ttyNowhere", port])
    monkeypatch.setattr(discovery, "can_channels", list)
    real = i2c_bus.open_bus
    for module in ("rig.discovery", "rig.devices", "doctor.bus"):
        monkeypatch.setattr(f"experiments.{module}.open_bus",
                            lambda path: rig_mock.imu if path == "/dev/i2c-7" else real(path))
    shell("init", path, "--probe")
    out = shell.out
    assert "no such bus" in out and "no such port" in out and "LSM9DS1 at 0x6A" in out
    rig = load_rig(path)
    assert (rig.devices.imu.bus, rig.devices.imu.address) == ("/dev/i2c-7", 0x6A)
    assert (rig.devices.controller.port, rig.devices.controller.rate_hz) == (port, 250.0)
    assert (rig.motor.gear_ratio, rig.limits.torque_nm) == (36.0, 1.25)
    assert rig_mock.firmware.drive.torque_nm == 0.0
    monkeypatch.setattr(preflight, "LISTEN_S", 0.5)
    path.write_text(path.read_text().replace("rate_hz = 238.0", "rate_hz = 59.5 ").replace("0.005 ", "5.0 "))
    shell("doctor --rig", path, "--out", path.parent)


def test_probing_where_there_is_nothing(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
                                        ) -> None:
    for name in ("DEV", "NET"):
        monkeypatch.setattr(discovery, name, tmp_path)
    shell("init", path, "--probe")
    out = shell.out
    assert "no I2C bus" in out and "no leg controller" in out
    rig = load_rig(path)
    assert rig.devices.imu is None and rig.devices.controller is None
    assert "# [devices.imu]" in path.read_text()


def test_where_is_looked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("i2c-1", "ttyACM0", "ttyUSB2", "ttyS0", "tty1"):
        (tmp_path / name).touch()
    for name, kind in (("can0", "280"), ("eth0", "1")):
        (tmp_path / "net" / name).mkdir(parents=True)
        (tmp_path / "net" / name / "type").write_text(kind + "\n")
    monkeypatch.setattr(discovery, "DEV", tmp_path)
    monkeypatch.setattr(discovery, "NET", tmp_path / "net")
    assert [Path(p).name for p in discovery.i2c_buses()] == ["i2c-1"]
    assert [Path(p).name for p in discovery.serial_ports()] == ["ttyACM0", "ttyUSB2"]
    assert discovery.can_channels() == ["can0"]
