"""Dynamixel: packets as the e-Manual prints them, units by model, the half-duplex line, the watchdog, refusals."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from daq import parse_rig
from daq.recording import record_run
from daq.runs import read_run
from drivers import DeviceAbsent
from drivers import dynamixel as dxl
from drivers.dynamixel import Address, Instruction
from drivers.dynamixel_drive import find_nodes
from drivers.errors import DeviceFault, ProtocolMismatch
from drivers.mock import FirmwareSettings
from drivers.mock.dynamixel_drive import MockDynamixel, new_table
from tests.support.drive_bench import (
    CONSTANT,
    DriveBench,
    driven,
    faults,
    fed_in_pieces,
    models_heard,
    opened,
    telemetry,
)
from tests.support.recordings import RIG, sine
from tests.support.spies import before
from tests.support.still_plant import StillPlant, StillState

PRINTED = [
    ("ping", dxl.packet(1, Instruction.PING), "FF FF FD 00 01 03 00 01 19 4E"),
    ("its status", dxl.status(1, 0, bytes([0x06, 0x04, 0x26])), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    ("read of the position", dxl.read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    ("its status", dxl.status(1, 0, bytes([0xA6, 0, 0, 0])), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    ("reboot", dxl.packet(1, Instruction.REBOOT), "FF FF FD 00 01 03 00 08 2F 4E"),
    ("sync read", dxl.packet(dxl.BROADCAST, Instruction.SYNC_READ, bytes([132, 0, 4, 0, 1, 2])),
     "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
    ("sync write", dxl.packet(dxl.BROADCAST, Instruction.SYNC_WRITE, struct.pack("<HHBIBI", 116, 4, 1, 150, 2, 170)),
     "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"),
]


@pytest.mark.parametrize("made, printed", [row[1:] for row in PRINTED], ids=[row[0] for row in PRINTED])
def test_packets_are_those_that_the_e_manual_prints(made: bytes, printed: str) -> None:
    assert made == bytes.fromhex(printed)
    (one,) = dxl.Decoder().feed(made)
    assert one.ident == made[4] and one.instruction == made[7]


def test_what_looks_like_a_header_is_stuffed_and_comes_back() -> None:
    data = b"\xff\xff\xfd\x00" * 5 + b"\xff\xff\xfd"
    sent = dxl.status(1, 0, data)
    assert sent[4:].count(b"\xff\xff\xfd\x00") == 0
    (one,) = dxl.Decoder().feed(sent)
    assert one.params == data


def test_any_cut_of_the_stream_gives_the_same_packets() -> None:
    fed_in_pieces(dxl.status, dxl.Decoder())


def test_broken_packets_are_counted_and_nothing_false_comes_through() -> None:
    rng, decoder, whole = np.random.default_rng(2), dxl.Decoder(), 0
    sent = {dxl.status(1, 0, bytes([k % 256]) * (k % 50 + 1)) for k in range(2000)}
    for one in sent:
        if rng.random() < 0.4:
            broken = bytearray(one)
            broken[int(rng.integers(len(broken)))] ^= 1 << int(rng.integers(8))
            one = bytes(broken)[: int(rng.integers(1, len(broken) + 1))]
        for packet in decoder.feed(one):
            assert dxl.status(packet.ident, packet.error, packet.params) in sent
            whole += 1
    assert whole > 0.5 * len(sent) and decoder.bad > 100


# -- units ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", sorted(dxl.MODELS))
@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_units_of_every_model(model: int, turns: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal in counts of this model is the torque that was asked for, to half a count, and so is the reading."""
    monkeypatch.setattr(MockDynamixel, "model", model)
    bench = DriveBench("dynamixel", StillPlant(StillState(q2=-0.7)), gear_ratio=1.0, turns=turns)
    bench.armed()
    bench.run(0.1, 0.6)
    unit = dxl.MODELS[model].current_a
    (goal,) = struct.unpack_from("<h", bench.far.table, Address.GOAL_CURRENT)
    assert goal == math.copysign(round(0.6 / CONSTANT / unit), turns)
    assert bench.rig.drive.motor.last_mean_nm == pytest.approx(0.6, abs=0.51 * unit * CONSTANT)
    seen = telemetry(bench.run(0.2, 0.6))
    assert np.mean([t.current_a for t in seen]) == pytest.approx(0.6 / CONSTANT, abs=0.01)
    assert {t.torque_cmd_nm for t in seen} == {0.6}  # what was asked for, not what became of it
    assert seen[-1].knee_rad == pytest.approx(-0.7, abs=math.pi / dxl.COUNTS)


def test_positions_go_on_over_many_turns_and_below_zero() -> None:
    for angle in (-300.0, -3.2, 3.2, 300.0):
        bench = opened("dynamixel", StillPlant(StillState(q2=angle)), gear_ratio=1.0, turns=1.0)
        assert telemetry(bench.run(0.05))[-1].knee_rad == pytest.approx(angle, abs=math.pi / dxl.COUNTS)


def test_the_tick_wraps_and_nothing_is_lost_by_it() -> None:
    bench = DriveBench("dynamixel", settings=FirmwareSettings(torque_constant_nm_per_a=CONSTANT,
                                                              first_tick_us=32_600_000))
    bench.drive.open()
    seen = telemetry(bench.run(0.5))
    assert len(seen) == pytest.approx(125, abs=4) and bench.drive.stats.reboots == 0


# -- the line ------------------------------------------------------------------------------------------------


def test_no_command_goes_out_between_a_request_and_its_answer() -> None:
    """On a line of half duplex they would collide."""
    bench = DriveBench("dynamixel")
    bench.armed(1000)
    sent, answered, transmit = list[tuple[int, bytes]](), list[int](), bench.far.transmit
    def heard(until_ns: int) -> list[tuple[int, bytes]]:
        out = transmit(until_ns)
        answered.extend(t_ns for t_ns, _ in out)
        return out

    bench.far.transmit = heard
    before(bench.link, "write", lambda data: sent.append((bench.clock.now_ns(), data)))
    for k in range(200):
        bench.drive.command(0.001 * k)
        bench.drive.poll()
    asked, commanded = ([t for t, data in sent if data.endswith(dxl.read(1, 64, 83)) is read] for read in (True, False))
    assert len(asked) > 20
    for since in asked:
        reply = min((t for t in answered if t > since), default=since)
        assert not any(since < t < reply for t in commanded)


def test_two_on_a_line_do_not_disturb_each_other() -> None:
    bench = DriveBench("dynamixel")
    bench.far.others[7] = new_table(7, 1200)
    bench.armed()
    assert len(telemetry(bench.run(0.4, 0.5))) == pytest.approx(100, abs=4)
    assert bench.far.others[7][Address.TORQUE_ENABLE] == 0
    assert struct.unpack_from("<h", bench.far.others[7], Address.GOAL_CURRENT)[0] == 0
    assert find_nodes(bench.link, bench.wiring) == [1, 7]


def test_a_sync_read_has_both_answer_in_turn() -> None:
    bench = DriveBench("dynamixel")
    bench.far.others[7] = new_table(7, 1200)
    bench.link.write(dxl.packet(dxl.BROADCAST, dxl.Instruction.SYNC_READ, bytes([Address.MODEL_NUMBER, 0, 2, 0, 7, 1])))
    assert models_heard(bench, dxl.Decoder()) == [(7, 1200), (1, 1040)]


# -- refusals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at, data, line", [
    (Address.MODEL_NUMBER, struct.pack("<H", 1060), "model number 1060 is none that this program knows"),
    (Address.FIRMWARE_VERSION, b"\x25", "firmware 37 has no Bus Watchdog.*DYNAMIXEL Wizard"),
    (Address.STATUS_RETURN_LEVEL, b"\0", "answers a ping and no read")])
def test_what_it_cannot_work_with_is_refused_with_a_remedy(at: int, data: bytes, line: str) -> None:
    bench = DriveBench("dynamixel")
    bench.far.table[at:at + len(data)] = data
    with pytest.raises((ProtocolMismatch, DeviceAbsent), match=line):
        bench.drive.open(0.5)


def test_another_operating_mode_becomes_current_control() -> None:
    bench = DriveBench("dynamixel")
    table = bench.far.table
    table[Address.OPERATING_MODE], table[Address.TORQUE_ENABLE] = 3, 1  # somebody left it holding a position
    bench.drive.open()
    assert table[Address.OPERATING_MODE] == dxl.CURRENT_MODE and not table[Address.TORQUE_ENABLE]
    bench.armed()


def test_a_hardware_error_goes_by_a_reboot_only() -> None:
    bench = driven("dynamixel")
    bench.far.driver_ok = False
    bench.run(0.05, 0.5)
    bench.far.driver_ok = True
    assert "electrical shock" in bench.drive.words
    with pytest.raises(DeviceFault, match="electrical shock"):
        bench.drive.arm(100)
    bench.drive.clear_faults()
    bench.run(0.3)
    assert bench.far.table[Address.HARDWARE_ERROR_STATUS] == 0
    bench.armed()
    assert telemetry(bench.run(0.1, 0.4))[-1].torque_cmd_nm == 0.4


def test_polls_alone_do_not_keep_the_torque_on() -> None:
    """Its watchdog counts any instruction: the driver falls silent where commands stop."""
    bench = DriveBench("dynamixel")
    bench.armed(100)
    bench.run(0.1, 1.0)
    since = bench.clock.now_ns()
    assert len(faults(bench.run(0.3))) == 1 and bench.zero_after(since) <= 0.1
    assert bench.far.table[Address.BUS_WATCHDOG] == dxl.WATCHDOG_ERROR


def test_a_plan_is_recorded_over_it_without_a_lost_sample(tmp_path: Path) -> None:
    bench = opened("dynamixel", turns=1.0)
    text = RIG.replace("[limits]\n", 'kind = "dynamixel"\nnode = 1\nrate_hz = 250.0\n[calibration]\n'
                       f"torque_constant_nm_per_a = {CONSTANT}\n[limits]\nunchecked = [\"encoder_s\", \"q1_rad\"]\n")
    report = record_run(tmp_path / "r.mcap", parse_rig(text), text, sine(0.8), None, bench.drive, bench.clock.now_ns,
                        threaded=False)
    raw = read_run(tmp_path / "r.mcap")
    seen = raw.streams["/leg/telemetry"]
    assert [event.kind for event in raw.events] == ["start", "stop"] and bench.drive.stats.lost == 0
    assert (np.diff(seen["seq"].astype(int)) == 1).all()
    assert seen.size == pytest.approx(2.1 * 250, rel=0.05) and report.clock_bound_s < 1e-3
    assert bench.far.torque_nm == 0.0
