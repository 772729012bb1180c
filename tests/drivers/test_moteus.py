"""moteus: what is its own, and its vendor's library against our emulator and our driver."""

import asyncio
import math
from typing import Any

import pytest

from drivers import Reaction
from drivers.can_frame import CanFrame
from drivers.errors import DeviceFault, ProtocolMismatch
from drivers.mock import MockRig, PtyServer, RealClock, drive_maker, on_serial
from drivers.mock.moteus_drive import MockMoteus
from drivers.moteus_drive import QUERY, MoteusDrive
from drivers.multiplex import WRITE, Kind, Register, parse, write
from tests.support.drive_bench import DriveBench, faults, opened, telemetry
from tests.support.still_plant import StillPlant


def test_its_own_limits_are_read_and_shown() -> None:
    bench = DriveBench("moteus")
    bench.far.config |= {"servopos.position_min": -10.0, "servopos.position_max": 20.0}
    assert bench.drive.open().torque_limit_nm == pytest.approx(2.1, rel=1e-5)
    limits, per_turn = bench.drive.limits, 2 * math.pi / 50
    assert limits.reaction == Reaction.LIMP and limits.speed_limit_radps == pytest.approx(40.0, rel=1e-4)
    assert (limits.position_min_rad, limits.position_max_rad) == pytest.approx((-20.0 * per_turn, 10.0 * per_turn))


@pytest.mark.parametrize("mode", [12.0, 10.0, 15.0, None])
def test_a_watchdog_that_would_not_take_the_torque_off_or_cannot_be_read_is_refused(mode: float | None) -> None:
    bench = DriveBench("moteus")
    bench.far.config["servo.timeout_mode"] = mode
    if mode is None:
        del bench.far.config["servo.timeout_mode"]
    bench.drive.open()
    with pytest.raises(DeviceFault, match="cannot be read" if mode is None else
                       rf"servo.timeout_mode is {mode:g}.*conf set servo.timeout_mode 0"):
        bench.drive.arm(100)
    bench.run(0.05, 1.0)
    assert bench.far.torque_nm == 0.0


def test_another_register_map_is_refused() -> None:
    bench = DriveBench("moteus")
    bench.far.map_version = 4
    with pytest.raises(ProtocolMismatch, match=r"register map 4, this program knows 5; flash"):
        bench.drive.open()


def test_without_the_counter_it_still_works() -> None:
    bench = DriveBench("moteus")
    bench.far.has_counter = False
    bench.drive.open()
    assert len(telemetry(bench.run(0.2))) > 90


def test_a_fault_has_its_number_and_name() -> None:
    bench = DriveBench("moteus")
    bench.armed()
    bench.far.bus_v = 50.0
    assert [report.value for report in faults(bench.run(0.05, 0.5))] == [34.0]
    assert "fault 34 over voltage" in bench.drive.words


def test_two_on_one_bus_hear_only_their_own() -> None:
    bench = DriveBench("moteus")
    other = MockMoteus(bench.far.settings, bench.wiring.__class__(node=2), 2, bench.clock.now_ns())
    true = bench.far.transmit

    def both(until_ns: int) -> list[tuple[int, Any]]:
        other.receive((CanFrame(0x8002, QUERY, True, True),), until_ns)
        return sorted(true(until_ns) + other.transmit(until_ns))

    bench.far.transmit = both
    bench.drive.open()
    bench.run(0.1)
    assert all(abs(t.bus_v - 24.0) < 0.1 for t in telemetry(bench.run(0.1)))


# -- the vendor's library ----------------------------------------------------------------------------------


def vendor() -> Any:
    return pytest.importorskip("moteus", reason="pip install moteus")


def test_the_vendors_library_drives_our_emulator_through_the_adapter() -> None:
    """Its transport opens the pseudo-terminal as an fdcanusb; query, torque, stop, and the console."""
    moteus, bench = vendor(), DriveBench("moteus")
    rig = MockRig(StillPlant(), RealClock(), make=drive_maker("moteus", bench.wiring))

    async def talk(path: str) -> dict[str, Any]:
        transport = moteus.Fdcanusb(path, disable_brs=False)
        resolution = moteus.QueryResolution()
        resolution.q_current = moteus.F32
        resolution._extra = {moteus.Register.MILLISECOND_COUNTER: moteus.INT32,
                             moteus.Register.REGISTER_MAP_VERSION: moteus.INT32}
        servo = moteus.Controller(id=1, transport=transport, query_resolution=resolution)
        try:
            await servo.set_stop()
            found = {"still": (await servo.query()).values}
            turning = await servo.set_position(position=math.nan, velocity=0.0, kp_scale=0.0, kd_scale=0.0,
                                               ilimit_scale=0.0, feedforward_torque=0.01, watchdog_timeout=0.2,
                                               query=True)
            assert turning is not None
            await asyncio.sleep(0.02)
            found["turning"] = (await servo.query()).values
            found["asked"] = getattr(rig.drive, "torque_nm", None)
            await asyncio.sleep(0.4)
            found["late"] = (await servo.query()).values
            await servo.set_stop()
            found["stopped"] = (await servo.query()).values
            stream = moteus.Stream(servo)
            found["conf"] = await stream.command(b"conf get servo.timeout_mode", allow_any_response=True)
            return found
        finally:
            transport.close()

    with PtyServer(on_serial("moteus", rig.drive), rig.clock) as server:
        found = asyncio.run(asyncio.wait_for(talk(server.path), 20.0))
    r = moteus.Register
    assert found["still"][r.MODE] == 0 and found["still"][r.FAULT] == 0 and found["still"][r.VOLTAGE] == 24.0
    assert found["turning"][r.MODE] == 10 and found["asked"] == pytest.approx(0.01)
    assert found["turning"][r.Q_CURRENT] == pytest.approx(0.01 * 50.0, abs=0.15)
    assert found["late"][r.MODE] == 11 and found["stopped"][r.MODE] == 0
    assert found["conf"].strip() == b"0"


def test_our_driver_builds_what_the_vendors_library_builds() -> None:
    """The same torque command, register by register."""
    servo = vendor().Controller(id=1)
    theirs = servo.make_position(position=math.nan, velocity=0.0, kp_scale=0.0, kd_scale=0.0, ilimit_scale=0.0,
                                 feedforward_torque=-0.02, maximum_torque=0.042, watchdog_timeout=0.1)
    bench, sent = opened("moteus"), list[CanFrame]()
    bench.link.write = sent.extend  # type: ignore[assignment]
    bench.drive.arm(100)
    sent.clear()
    bench.drive.command(1.0)
    ours, wanted = registers(sent[0].data), registers(bytes(theirs.data))
    assert {Register.MODE, Register.COMMAND_TORQUE, Register.WATCHDOG_TIMEOUT} <= set(wanted) <= set(ours)
    for register, value in wanted.items():
        assert ours[register] == pytest.approx(value, nan_ok=True, rel=1e-5), register
    assert registers(bytes(servo.make_stop().data)) == {Register.MODE: 0}


def test_the_vendors_parser_reads_our_emulators_answer() -> None:
    moteus, bench = vendor(), DriveBench("moteus")
    protocol = pytest.importorskip("moteus.protocol")
    bench.far.receive((CanFrame(0x8001, QUERY, True, True),), bench.clock.now_ns())
    bench.clock.advance(1_000_000)
    ((_, frames),) = [item for item in bench.far.transmit(bench.clock.now_ns()) if item[1]]
    values, r = protocol.parse_reply(frames[0].data), moteus.Register
    assert [values[one] for one in (r.MODE, r.VOLTAGE, r.TEMPERATURE)] == pytest.approx([0, 24.0, 30.0])


def registers(data: bytes) -> dict[int, float]:
    """What a frame writes."""
    return {part.start + k: value for part in parse(data) if part.op == WRITE for k, value in enumerate(part.values)}


def test_an_answer_that_is_not_whole_is_none() -> None:
    """Found by broken frames: registers missing, or a mode that is no number."""
    bench = opened("moteus")
    drive = bench.drive
    assert isinstance(drive, MoteusDrive)
    for data in (write(Kind.INT8, Register.MODE, [0]) + write(Kind.F32, Register.CONTROL_TORQUE, [0.0]),
                 write(Kind.F32, Register.MODE, [math.nan])):
        answer = bytes([data[0] | 0x20]) + data[1:]
        assert drive._hear((CanFrame(0x100, answer, False, True),)) is None
    assert len(telemetry(bench.run(0.1))) > 40
