"""ODrive: what is its own, and the published DBC against our frames and our emulator."""

import math
import struct
from importlib.resources import files
from typing import Any

import pytest

from drivers import cansimple
from drivers.can_frame import CanFrame
from drivers.cansimple import CLOSED_LOOP, IDLE, LAYOUT, Msg, OdriveError, message, request, values_of
from drivers.errors import DeviceFault, ProtocolMismatch
from drivers.mock.odrive_drive import ASKED
from tests.support.drive_bench import CONSTANT, DriveBench, opened, telemetry
from tests.support.spies import recorded

OTHER_FIRMWARE = r"firmware 0\.\d\.\d, this program speaks CANSimple of 0.6; flash"


@pytest.fixture
def armed() -> DriveBench:
    bench = DriveBench("odrive")
    arm_and_wait(bench)
    return bench


def arm_and_wait(bench: DriveBench) -> None:
    bench.drive.open()
    bench.run(0.05)
    bench.drive.arm(100)
    bench.run(1.0, 0.0)


def test_the_watchdog_is_proven_before_the_motor_turns() -> None:
    bench = opened("odrive")
    bench.run(0.05)
    began = bench.clock.now_ns()
    bench.drive.arm(100)
    bench.run(0.08, 0.7)
    assert bench.far.axis == CLOSED_LOOP and not bench.drive.armed
    bench.run(0.5, 0.7)
    assert bench.drive.armed and bench.far.torque_nm == pytest.approx(-0.7 / 50)
    t_ns, commanded, _ = bench.far.record
    first = t_ns[commanded != 0.0][0]
    assert first - began > 100e6, "nothing may turn before the watchdog has shown itself"


@pytest.mark.parametrize("setting, value, how", [
    ("watchdog_on", False, "did not act in time"), ("watchdog_s", 1.0, "did not act in time"),
    ("watchdog_s", 0.03, "acted after"), ("polling_feeds", True, "did not act in time")])
def test_a_watchdog_that_would_not_end_the_torque_is_refused(setting: str, value: Any, how: str) -> None:
    bench = DriveBench("odrive")
    setattr(bench.far, setting, value)
    with pytest.raises(DeviceFault, match=rf"its watchdog {how}.*watchdog_timeout = 0.1, enable_watchdog = True"):
        arm_and_wait(bench)
    bench.run(0.05, 1.0)
    assert bench.far.torque_nm == 0.0 and bench.far.axis == IDLE


def test_limits_are_written_as_it_is_armed(armed: DriveBench) -> None:
    assert armed.far._limits == pytest.approx((1.5 * 15.0 * 50 / (2 * math.pi), 1.5 * 2.0 / CONSTANT))


@pytest.mark.parametrize("setting, value, error, said", [
    ("version", (2, 4, 4, 58, 0, 5, 6, 0), ProtocolMismatch, OTHER_FIRMWARE),
    ("version", (2, 4, 4, 58, 0, 7, 0, 0), ProtocolMismatch, OTHER_FIRMWARE),
    ("deaf", {Msg.GET_TORQUES}, ProtocolMismatch, "does not answer GET_TORQUES; flash a newer"),
    ("cyclic", {Msg.GET_ENCODER_ESTIMATES: 10_000_000}, DeviceFault,
     r"sends GET_ENCODER_ESTIMATES unasked.*encoder_msg_rate_ms")])
def test_another_firmware_a_missing_message_and_one_that_comes_unasked_are_refused(
        setting: str, value: Any, error: type[Exception], said: str) -> None:
    bench = DriveBench("odrive")
    setattr(bench.far, setting, value)
    with pytest.raises(error, match=said):
        bench.drive.open()


def test_an_error_is_named_in_its_words_and_cleared_by_its_message(armed: DriveBench) -> None:
    bench = armed
    bench.far.driver_ok = False
    bench.run(0.05, 0.5)
    assert "DRV_FAULT" in bench.drive.words
    bench.drive.clear_faults()
    bench.run(0.05)
    assert bench.drive.telemetry.faults, "the cause is still there"
    bench.far.driver_ok = True
    bench.drive.clear_faults()
    bench.run(0.05)
    assert not bench.drive.telemetry.faults


def test_an_axis_that_stops_beating_is_not_armed(armed: DriveBench) -> None:
    armed.run(0.5, 0.5)
    assert armed.drive.armed
    armed.far._beat_ns = 2**62
    armed.run(0.6, 0.5)
    assert not armed.drive.armed


def test_250_a_second_fit_the_bus_at_a_megabit(armed: DriveBench) -> None:
    """Frames as long as bit stuffing can make them."""
    sent = recorded(armed.link, "write")
    assert len(telemetry(armed.run(1.0, 0.3))) > 240
    assert sum(bits(len(f.data)) + (bits(8) if f.remote else 0) for (frames,) in sent for f in frames) < 0.3e6


def bits(length: int) -> float:
    """Of a frame with an 11-bit identifier, stuffed at worst, and the gap behind it."""
    return 47 + 8 * length + (34 + 8 * length - 1) // 4


# -- the published DBC -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dbc() -> Any:
    cantools = pytest.importorskip("cantools.database")
    pytest.importorskip("odrive_can", reason="pip install odrive-can: it carries the published DBC of 0.6.10")
    text = files("odrive_can").joinpath("dbc/odrive-cansimple-0.6.10.dbc").read_text()
    return cantools.load_string(text, "dbc", strict=False)


NAMES = {msg: "Axis0_" + msg.name.title() for msg in Msg}


def test_every_message_has_the_published_identifier_and_length(dbc: Any) -> None:
    published = {m.name: m for m in dbc.messages if m.name.startswith("Axis0_")}
    for msg in Msg:
        assert published[NAMES[msg]].frame_id == msg, msg
        zeros = struct.unpack(LAYOUT[msg], bytes(struct.calcsize(LAYOUT[msg])))
        assert len(message(5, msg, *zeros).data) <= published[NAMES[msg]].length


def test_the_published_dbc_reads_our_commands(dbc: Any) -> None:
    def read(frame: CanFrame) -> dict[str, Any]:
        m = dbc.get_message_by_frame_id(frame.can_id & 0x1F)
        return dict(m.decode(frame.data.ljust(m.length, b"\0"), decode_choices=False))

    torque = read(message(0, Msg.SET_INPUT_TORQUE, 0.25))["Input_Torque"]
    assert as_float(torque) == 0.25
    assert read(message(0, Msg.SET_AXIS_STATE, CLOSED_LOOP))["Axis_Requested_State"] == 8
    mode = read(message(0, Msg.SET_CONTROLLER_MODE, 1, 1))
    assert (mode["Control_Mode"], mode["Input_Mode"]) == (1, 1)
    limits = read(message(0, Msg.SET_LIMITS, 20.0, 5.0))
    assert (as_float(limits["Velocity_Limit"]), as_float(limits["Current_Limit"])) == (20.0, 5.0)


def test_the_published_dbc_reads_our_emulators_answers_and_we_read_what_it_writes(dbc: Any) -> None:
    bench = DriveBench("odrive")
    for msg in ASKED:
        bench.far.receive((request(0, msg),), bench.clock.now_ns())
    bench.clock.advance(1_000_000)
    answers = {f.can_id: f for _, frames in bench.far.transmit(bench.clock.now_ns()) for f in frames}
    m = {msg: dbc.get_message_by_name(NAMES[msg]).decode(answers[msg].data, decode_choices=False) for msg in ASKED}
    assert (m[Msg.GET_VERSION]["Fw_Version_Major"], m[Msg.GET_VERSION]["Fw_Version_Minor"]) == (0, 6)
    assert as_float(m[Msg.GET_BUS_VOLTAGE_CURRENT]["Bus_Voltage"]) == pytest.approx(24.0)
    assert m[Msg.GET_ERROR] == {"Active_Errors": 0, "Disarm_Reason": 0}
    beat = dbc.get_message_by_name("Axis0_Heartbeat")
    data = beat.encode({"Axis_Error": 1 << 24, "Axis_State": 8, "Procedure_Result": 0, "Trajectory_Done_Flag": 0})
    told = values_of(CanFrame(Msg.HEARTBEAT, bytes(data)))
    assert told == (Msg.HEARTBEAT, (OdriveError.WATCHDOG_TIMER_EXPIRED, CLOSED_LOOP, 0, 0))


def test_the_errors_have_the_published_bits(dbc: Any) -> None:
    choices = dbc.get_message_by_name("Axis0_Heartbeat").get_signal_by_name("Axis_Error").choices
    published = {str(name): bit for bit, name in choices.items() if bit}
    assert {e.name: int(e) for e in OdriveError} == published
    assert cansimple.error_names(1 << 24 | 1 << 20) == "WATCHDOG_TIMER_EXPIRED, 0x100000"


def as_float(value: float) -> float:
    """Of a signal that the DBC has as a plain number of 32 bits, or as a float."""
    return value if isinstance(value, float) else struct.unpack("<f", struct.pack("<I", value))[0]
