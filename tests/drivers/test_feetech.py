"""Feetech STS: packets, signs, units, the half-duplex line, what turns it off, and that nothing turns it on."""

import math
import struct

import numpy as np
import pytest

from drivers import feetech as sts
from drivers.errors import ProtocolMismatch
from drivers.feetech import Address, Instruction
from drivers.feetech_drive import find_nodes
from drivers.mock.feetech_drive import new_table
from drivers.protocol import Fault
from tests.support.drive_bench import DriveBench, faults, fed_in_pieces, models_heard, opened, telemetry
from tests.support.spies import recorded
from tests.support.still_plant import MovingPlant, StillPlant, StillState

PRINTED = [("ping of 1", sts.packet(1, Instruction.PING), "FF FF 01 02 01 FB"),
           ("its answer", sts.packet(1, 0), "FF FF 01 02 00 FC"),
           ("read of the position", sts.read(1, 0x38, 2), "FF FF 01 04 02 38 02 BE"),
           ("its answer, 1304", sts.packet(1, 0, b"\x18\x05"), "FF FF 01 04 00 18 05 DD"),
           ("write of an identifier", sts.packet(0xFE, Instruction.WRITE, b"\x05\x01"), "FF FF FE 04 03 05 01 F4")]
"""As Feetech's "SCS Communication Protocol Manual" prints them."""


@pytest.mark.parametrize("made, printed", [row[1:] for row in PRINTED], ids=[row[0] for row in PRINTED])
def test_packets_are_those_that_the_manual_prints(made: bytes, printed: str) -> None:
    assert made == bytes.fromhex(printed)
    (one,) = sts.Decoder().feed(made)
    assert (one.ident, one.code, one.params) == (made[2], made[4], made[5:-1])


def test_a_sign_is_a_bit_above_a_magnitude() -> None:
    for bit in (10, 11, 15):
        most = 2**bit - 1
        for number in (0, 1, -1, most, -most):
            assert sts.to_signed(sts.from_signed(number, bit), bit) == number
        assert sts.to_signed(sts.from_signed(-3 * most, bit), bit) == -most
    assert sts.from_signed(-1000, 10) == 2024 and sts.to_signed(0x8001) == -1


def test_any_cut_of_the_stream_gives_the_same_packets_and_damage_is_counted() -> None:
    decoder = sts.Decoder()
    sent = fed_in_pieces(sts.packet, decoder)
    broken = bytearray(sent[7])
    broken[-1] ^= 1
    assert decoder.feed(bytes(broken) + sent[8])[-1] == sts.Decoder().feed(sent[8])[0]
    assert decoder.bad >= 1


@pytest.mark.parametrize("turns", [1.0, -1.0])
@pytest.mark.parametrize("angle, phase", [(0.4, 0), (3.0, 0), (-7.5, sts.MULTI_TURN), (20.0, sts.MULTI_TURN)])
def test_angles_currents_and_volts_are_the_joint_s(turns: float, angle: float, phase: int) -> None:
    bench = DriveBench("feetech", StillPlant(StillState(q2=angle)), turns=turns)
    bench.far.table[Address.PHASE] = phase
    bench.drive.open()
    bench.far.motor.last_mean_nm = 0.0
    seen = telemetry(bench.run(0.2))[-1]
    gap = (seen.knee_rad - angle + math.pi) % (2.0 * math.pi) - math.pi
    assert abs(gap) <= math.pi / sts.COUNTS * 1.01
    assert not phase or seen.knee_rad == pytest.approx(angle, abs=math.pi / sts.COUNTS * 1.01)
    assert seen.bus_v == pytest.approx(24.0, abs=0.11) and seen.torque_cmd_nm == 0.0
    assert abs(seen.current_a) < 0.1


def test_a_position_within_a_turn_goes_on_over_its_end() -> None:
    bench = opened("feetech", MovingPlant(lambda t: StillState(q2=8.0 * t, q2d=8.0)), turns=1.0)
    knee = np.array([t.knee_rad for t in telemetry(bench.run(3.0))])
    assert knee[-1] - knee[0] == pytest.approx(24.0, rel=0.02) and np.abs(np.diff(knee)).max() < 0.1


def test_a_bridge_without_current_feedback_has_no_current() -> None:
    bench = DriveBench("feetech")
    bench.far.table[Address.PHASE] = sts.NO_CURRENT
    bench.drive.open()
    assert all(math.isnan(t.current_a) for t in telemetry(bench.run(0.1)))


def running(bench: DriveBench) -> None:
    """Somebody else's program has it in PWM mode, half on."""
    far = bench.far
    far.table[Address.MODE], far.table[Address.TORQUE_ENABLE] = sts.PWM_MODE, 1
    struct.pack_into("<H", far.table, Address.GOAL_TIME, sts.from_signed(-500, 10))
    far._control()
    assert far.torque_nm < 0.0


def test_a_motor_that_somebody_left_on_is_turned_off() -> None:
    bench = DriveBench("feetech")
    running(bench)
    bench.drive.open()
    bench.run(0.05)
    assert bench.far.torque_nm == 0.0 and bench.far.table[Address.TORQUE_ENABLE] == 0
    running(bench)  # and again, while legid reads
    since = bench.clock.now_ns()
    bench.run(0.1)
    assert bench.far.torque_nm == 0.0 and bench.zero_after(since) < 0.02


@pytest.mark.parametrize("way", ["stop", "close", "clear_faults"])
def test_it_is_off_after(way: str) -> None:
    bench = opened("feetech")
    bench.run(0.02)
    running(bench)
    getattr(bench.drive, way)()
    bench.alone(0.003)
    assert bench.far.torque_nm == 0.0


def test_no_byte_of_the_driver_turns_it_on() -> None:
    bench = DriveBench("feetech")
    sent = recorded(bench.link, "write")
    bench.drive.open()
    bench.run(0.1, 0.5)
    bench.drive.stop()
    bench.drive.clear_faults()
    bench.run(0.1, 0.5)
    bench.drive.close()
    writes = [one.params for one in sts.Decoder().feed(b"".join(data for (data,) in sent))
              if one.code not in (Instruction.READ, Instruction.PING)]
    assert len(writes) >= 4 and set(writes) == {bytes([Address.TORQUE_ENABLE, 1, 1, 0])}


@pytest.mark.parametrize("part, state, fault, said", [
    ("encoder_ok", False, Fault.KNEE_ENCODER, "magnetic encoder"),
    ("bus_v", 10.0, Fault.UNDERVOLTAGE, "input voltage"),
    ("bus_v", 25.4, Fault.OVERVOLTAGE, "input voltage"),
    ("degc", 120.0, Fault.OVERTEMPERATURE, "overheating"),
    ("driver_ok", False, Fault.OVERCURRENT, "overcurrent")])
def test_its_faults_have_our_names(part: str, state: float, fault: Fault, said: str) -> None:
    bench = opened("feetech")
    bench.run(0.05)
    setattr(bench.far, part, state)
    assert [report.fault for report in faults(bench.run(0.1))] == [fault] and said in bench.drive.words


def test_another_model_is_refused_by_name() -> None:
    bench = DriveBench("feetech")
    struct.pack_into("<H", bench.far.table, Address.MODEL, 1284)
    with pytest.raises(ProtocolMismatch, match="model number 1284 is none that this program knows; use one of STS3215"):
        bench.drive.open(0.5)


def test_an_adapter_that_echoes_does_not_disturb() -> None:
    bench = DriveBench("feetech")
    bench.far.echoes = True
    bench.drive.open()
    assert len(telemetry(bench.run(0.5))) == pytest.approx(100, abs=5)


def test_several_on_a_line_are_found() -> None:
    bench = DriveBench("feetech")
    bench.far.others[7] = new_table(7)
    assert find_nodes(bench.link, bench.wiring) == [1, 7]
    bench.link.write(sts.packet(sts.BROADCAST, sts.Instruction.SYNC_READ, bytes([Address.MODEL, 2, 7, 1])))
    assert models_heard(bench, sts.Decoder()) == [(7, 777), (1, 777)]
