"""The firmware core in C: alone, against the emulator byte for byte, and serving a port to the real driver."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import FaultReport, Hello, Message, Pong, Reaction, State, Telemetry
from drivers.can_codec import CanCodec
from drivers.can_frame import CanFrame
from drivers.protocol import (
    Arm,
    ClearFaults,
    Decoder,
    DriveLimits,
    Fault,
    Feature,
    HelloRequest,
    LimitsRequest,
    Ping,
    Stop,
    TimedCommand,
    TorqueCommand,
    encode,
)
from tests.support.c_firmware import (
    SOURCES,
    STRICT,
    Answer,
    Event,
    as_bytes,
    compiler,
    emulate,
    host_program,
    run_core,
    run_script,
)
from tests.support.wire_by_hand import cobs_by_hand, crc_ccitt_false

LOST = -(2**31)
UNKNOWN = bytes.fromhex("04 09 D9 70 00")
"""A whole frame of type 0x09, which does not exist."""
ALONE = {"memcpy", "memset", "memmove", "memcmp"}
"""What a freestanding C compiler may call by itself."""


def rx(t_us: int, *messages) -> Event:
    return Event(t_us, "rx", b"".join(map(encode, messages)).hex())


def heard(end: Answer, kind: type, node: int | None = None) -> list[Any]:
    """The messages of a kind among all bytes sent."""
    codec: Any = CanCodec(node) if node else Decoder()
    return [m for m in codec.feed(split(end.sent) if node else end.sent) if isinstance(m, kind)]


def compare(script: list[Event], end_us: int, node: int | None = None) -> Answer:
    expected, boots = emulate(script, end_us, node)
    got = run_core(script, end_us, boots, node)
    assert got.sent.hex(" ") == expected.sent.hex(" ")
    assert got == expected
    return got


def test_core_needs_nothing(tmp_path: Path) -> None:
    own: set[str] = set()
    missing: set[str] = set()
    for source in (SOURCES / name for name in ("leg_codec.c", "leg_core.c", "leg_config.c", "leg_can.c")):
        out = tmp_path / f"{source.stem}.o"
        subprocess.run([compiler(), *STRICT, "-Wconversion", "-ffreestanding", "-c", str(source), "-o", str(out)],
                       check=True)
        for line in subprocess.run(["nm", str(out)], capture_output=True, text=True, check=True).stdout.splitlines():
            *_, kind, name = line.split()
            (missing if kind == "U" else own).add(name)
    assert missing - own <= ALONE


def test_a_scripted_session_byte_for_byte() -> None:
    script = [
        rx(0, HelloRequest(), Ping(7)), rx(1_234, TorqueCommand(0, 0.5)), rx(3_000, Arm(50)),
        *[rx(4_000 + 1_700 * k, TorqueCommand(k, 0.25 * (k % 5 - 2))) for k in range(20)],
        rx(40_000, TorqueCommand(19, 1.0), TorqueCommand(3, 1.0), Ping(65535)),  # repeated, late
        rx(100_000, Arm(50), Stop(), ClearFaults()),  # the watchdog has bitten meanwhile
        rx(101_001, Arm(1000), TorqueCommand(65535, -0.004)), rx(102_000, TorqueCommand(0, 2.000001)),
        rx(110_000, ClearFaults(), Stop(), ClearFaults(), Arm(4), Arm(1001), Arm(5)),
        Event(1_100_000, "reboot"), rx(1_100_000, Arm(100)), rx(1_101_000, TorqueCommand(9, 0.5)),
    ]
    end = compare(script, 2_300_000)
    assert len(heard(end, Hello)) == 5  # boot, asked for, 1 s, second boot, 1 s after it
    reports = [(m.fault, round(m.value, 6)) for m in heard(end, FaultReport)]
    assert [f for f, _ in reports] == [1, 1, 128, 1, 1]
    assert reports[2] == (128, 2.000001)
    assert end[1:] == (int(State.FAULT), 0, (0, 0, 0), 0)


@pytest.mark.parametrize("name, value, good, fault, shown", [
    ("bus_mv", 12_000, 24_000, Fault.UNDERVOLTAGE, 12.0), ("bus_mv", 31_000, 24_000, Fault.OVERVOLTAGE, 31.0),
    ("motor_cdegc", 9_500, 2_500, Fault.OVERTEMPERATURE, 95.0), ("knee", LOST, 0, Fault.KNEE_ENCODER, None),
    ("knee_hall", LOST, 0, Fault.KNEE_HALL, None), ("pivot_hall", LOST, 0, Fault(0), None),
    ("knee_speed", -50_000_000, 0, Fault.OVERSPEED, -50.0), ("gate_driver", 1, 0, Fault.GATE_DRIVER, None),
    ("angle", 6_281_000, 0, Fault.POSITION_LIMIT, 6.281), ("angle", -7_000_000, 0, Fault.POSITION_LIMIT, -7.0),
    ("estop", 1, 0, Fault.ESTOP, None), ("current", LOST, 0, Fault.OVERCURRENT, None),
    ("motor_cdegc", -(2**15), 2_500, Fault.OVERTEMPERATURE, None), ("bus_mv", 65535, 24_000, Fault.UNDERVOLTAGE, None),
    ("knee_speed", LOST, 0, Fault.OVERSPEED, None)])
def test_every_cause_latches_alike(name: str, value: int, good: int, fault: Fault, shown: float | None) -> None:
    script = [rx(0, Arm(1000), TorqueCommand(0, 0.5)), Event(10_000, "set", name, value),
              rx(14_000, Stop(), ClearFaults(), Arm(50)), Event(20_000, "set", name, good),
              rx(24_000, ClearFaults(), Arm(50))]
    end = compare(script, 30_000)
    reports = heard(end, FaultReport)
    assert {m.fault for m in reports} == ({int(fault)} if fault else set())
    assert shown is None or {m.value for m in reports} == {shown}
    assert end.state == State.ARMED
    assert not any(m.torque_cmd_nm for m in heard(end, Telemetry) if m.faults)


@pytest.mark.parametrize("node", [None, 3])
def test_the_estop_input_is_in_every_telemetry_and_nothing_arms_under_it(node: int | None) -> None:
    codec: Any = CanCodec(3) if node else Decoder()

    def said(t_us: int, *messages: Message) -> list[Event]:
        return [Event(t_us, "rx", as_bytes(codec.encode(m)).hex()) for m in messages]

    script = [Event(2_000, "set", "estop", 1), *said(3_000, Arm(50)), *said(9_000, Stop(), ClearFaults(), Arm(50)),
              Event(20_000, "set", "estop", 0), *said(23_000, ClearFaults(), Arm(50), TorqueCommand(0, 0.5))]
    end = compare(script, 30_000, node)
    frames = heard(end, Telemetry, node)
    assert [m.estop_open for m in frames] == [2_000 < m.tick_us - frames[0].tick_us + 2_000 <= 20_000 for m in frames]
    assert end.state == State.ARMED and end.torque_unm == 500_000


def test_torque_shrinks_towards_a_limit_and_is_whole_away_from_it() -> None:
    script = [rx(0, Arm(1000), TorqueCommand(0, 1.0)), Event(4_000, "set", "angle", 6_130_001),
              Event(8_000, "set", "angle", 6_279_000), rx(11_000, TorqueCommand(1, -1.0)),
              Event(14_000, "set", "angle", -6_080_000), Event(20_000, "set", "angle", 0),
              Event(24_000, "set", "knee_speed", 36_000_000), rx(27_000, TorqueCommand(2, 1.0)),
              Event(30_000, "set", "knee_speed", -39_999_999)]
    end = compare(script, 40_000)
    torques = [m.torque_cmd_nm for m in heard(end, Telemetry)]
    changes = [b for a, b in zip([None, *torques], torques) if a != b]
    assert changes == [1.0, 0.499996, 0.003333, -1.0, -0.666666, -1.0, 0.5, 1.0]


@pytest.mark.parametrize("reaction", list(Reaction))
def test_reactions_of_the_drive(reaction: Reaction) -> None:
    """The host falls silent while the knee moves; then a sensor is lost, behind which there is only limp."""
    script = [Event(0, "set", "reaction", int(reaction)), rx(0, Arm(20), TorqueCommand(0, 1.0)),
              Event(10_000, "set", "angle", 100_000), Event(30_000, "set", "angle", 140_003),
              Event(40_000, "set", "knee_speed", 1_000_001), Event(60_000, "set", "bus_mv", 9_000)]
    end = compare(script, 100_000)
    held = {m.torque_cmd_nm for m in heard(end, Telemetry) if m.faults == Fault.WATCHDOG}
    assert sorted(held) == ([-1.5, -0.80006, 0.0] if reaction == Reaction.HOLD else [0.0])
    assert end.torque_unm == 0
    lines = [f"0 set reaction {int(reaction)}", f"0 rx {encode(Arm(20)).hex()}"]
    bridge = {Reaction.LIMP: 0, Reaction.BRAKE: 2, Reaction.HOLD: 1}[reaction]
    assert [run_script([*lines, f"{t} end"])[2][2] for t in (10_000, 60_000)] == [1, bridge]
    assert run_script([*lines, f"50000 rx {encode(Stop()).hex()}", "60000 end"])[2][2] == 0
    assert run_script([*lines, "600000 end"])[2][2] == (2 if reaction == Reaction.BRAKE else 0)


def test_a_command_is_as_old_as_the_telemetry_that_it_answers() -> None:
    def timed(t_us: int, seq: int, seen: int) -> Event:
        return rx(t_us, TimedCommand(seq, 0.1 * seq, seen % 65536))

    script = [rx(0, Arm(20)), timed(1_000, 1, -1), timed(15_000, 2, 6), timed(16_500, 3, 60_000), timed(25_000, 4, 1),
              timed(25_500, 5, 2), rx(26_000, TorqueCommand(9, 0.9)), timed(26_500, 10, 13)]
    end = compare(script, 30_000)
    torques = {m.torque_cmd_nm for m in heard(end, Telemetry)}
    assert torques == {0.1, 0.2, 0.5} and end.late == 4 and end.torque_unm == 500_000
    late = [*script, *[timed(32_000 + 500 * k, 20 + k, 12) for k in range(200)]]  # a buffer that empties
    assert compare(late, 140_000).state == State.FAULT


def test_what_the_drive_says_of_itself() -> None:
    for node in (None, 3):
        codec: Any = CanCodec(3) if node else Decoder()
        end = compare([Event(1_000, "rx", as_bytes(codec.encode(LimitsRequest())).hex())], 2_000, node)
        assert heard(end, DriveLimits, node) == [
            DriveLimits(Feature.TIMED_COMMANDS | Feature.ESTOP_INPUT, Reaction.LIMP, 40.0, -6.28, 6.28)]


def test_torque_is_zero_in_time_where_nobody_polls_or_samples() -> None:
    start = [f"0 rx {(encode(Arm(50)) + encode(TorqueCommand(0, 0.5))).hex()}"]
    assert run_script([*start, "10000 stall poll 1", "49500 end"])[2][1:3] == [500_000, 1]
    for end_us in (50_000, 2**31 + 60_000, 2**32 + 20_000):  # over half of the tick, where a difference turns its sign
        asked = [*start, "10000 stall poll 1", "50500 stall poll 1", f"50500 jump {end_us}", f"{end_us} end"]
        assert run_script(asked)[2][1:3] == [0, 0]
    again = encode(TorqueCommand(1, 0.5)).hex()
    _, _, (state, torque, *_) = run_script([*start, "10000 stall poll 1", f"5000000 rx {again}", "5000500 end"])
    assert (state, torque) == (State.FAULT, 0)  # 5 s late
    arm_long = [f"0 rx {(encode(Arm(1000)) + encode(TorqueCommand(0, 0.5))).hex()}", "10000 stall sample 1"]
    assert run_script([*arm_long, "17500 end"])[2][1] == 500_000
    frames, _, (state, torque, *_) = run_script([*arm_long, "18000 stall poll 0", "18500 end"])
    assert (state, torque) == (State.FAULT, 0)
    reports = [m for m in Decoder().feed(b"".join(frames)) if isinstance(m, FaultReport)]
    assert [m.fault for m in reports] == [Fault.INTERNAL]


def test_the_hardware_watchdog_is_restarted_only_while_everything_runs() -> None:
    kicks = {what: [run_script([f"20000 stall {what} 1", f"{end} end"])[2][3] for end in (30_000, 90_000)]
             for what in ("poll", "sample", "torque")}
    assert all(first == last for first, last in kicks.values()), kicks
    assert run_script(["90000 end"])[2][3] > 170


@pytest.mark.parametrize("what, refusal", [
    ("none 0", 0), ("telemetry_hz 0", 3), ("telemetry_hz 300", 3), ("telemetry_hz 1001", 3), ("gear_ratio 0", 4),
    ("torque_limit 0", 5), ("torque_limit -5", 5), ("torque_limit 134217728", 5), ("watchdog_ms 4", 6),
    ("watchdog_ms 1001", 6), ("current_limit 0", 7), ("current_limit -2147483648", 7), ("temperature_limit 0", 8),
    ("temperature_limit 20001", 8), ("undervoltage 0", 9), ("undervoltage 30000", 9), ("overvoltage 65535", 9),
    ("speed_limit 0", 10), ("speed_derate 40000001", 10), ("position_min 6280000", 11),
    ("position_min -2147483648", 11), ("position_derate -1", 11), ("position_derate 6280001", 11),
    ("reaction 3", 12), ("hold_torque 2000001", 12),
    ("hold_torque 0", 12), ("hold_ms 0", 12), ("hold_ms 500", 0), ("no_kick 0", 1), ("no_estop 0", 1)])
def test_nonsense_is_refused_at_boot(what: str, refusal: int) -> None:
    said = subprocess.run([host_program(), "examine"], input=what, capture_output=True, text=True, check=True).stdout
    assert int(said.split()[-1].rpartition("\0")[2]) == refusal


def random_script(rng: np.random.Generator, seconds: float) -> list[Event]:
    """Sense and nonsense: commands in and out of order, broken frames, garbage, lost sensors, reboots."""
    script, t, seq = [], 0, int(rng.integers(65536))
    readings = {"angle": (0, 6_100_000, -6_200_000, 6_300_000), "estop": (0, 1), "reaction": (0, 1, 2),
                "knee": (0, LOST), "bus_mv": (24_000, 9_000, 40_000, 65535),
                "motor_cdegc": (2_500, -1_000, 9_900, -(2**15)), "current": (0, LOST),
                "knee_hall": (0, LOST), "pivot_hall": (0, LOST), "gate_driver": (0, 1),
                "knee_speed": (0, 35_000_000, -39_000_000, 41_000_000, LOST)}
    while t < seconds * 1e6:
        t += int(rng.choice([0, 137, 500, 2_000, 7_500]))
        dice = rng.random()
        if dice < 0.05:
            t = -(-t // 2_000) * 2_000
            name = str(rng.choice(list(readings)))
            script.append(Event(t, "set", name, int(rng.choice(readings[name]))))
            t += 2_000  # a sample sees it before the next frame comes
        elif dice < 0.09:
            t = -(-t // 2_000) * 2_000
            script += [Event(t, "set", name, good) for name, (good, *_) in readings.items() if name != "reaction"]
            t += 2_000
            script.append(rx(t, Stop(), ClearFaults(), Arm(100)))
        elif dice < 0.10:
            t = -(-t // 500) * 500
            script.append(Event(t, "reboot"))
        elif dice < 0.8:
            seq += int(rng.choice([1, 1, 1, 1, 0, 2, -3, 40_000]))
            command = seq % 65536, int(rng.integers(-500_200, 500_200)) * 4e-6
            seen = (t // 2_000 - int(rng.choice([1, 1, 1, 9, 60]))) % 65536
            script.append(rx(t, TimedCommand(*command, seen) if rng.random() < 0.3 else TorqueCommand(*command)))
        else:
            down: list[Message] = [Arm(int(rng.choice([4, 5, 20, 100, 1000, 1001]))), Stop(), ClearFaults(),
                                   HelloRequest(), LimitsRequest(), Ping(int(rng.integers(65536)))]
            known = [*(encode(m) for m in down), UNKNOWN]
            data = b"".join(known[int(i)] for i in rng.integers(len(known), size=rng.integers(1, 4)))
            if rng.random() < 0.4:
                data = broken(rng, data)
            script.append(Event(t, "rx", data.hex()))
    return script


def broken(rng: np.random.Generator, data: bytes) -> bytes:
    """A few bytes changed, dropped, doubled, or noise in front."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(out)))
        kind = rng.integers(4)
        if kind == 0:
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 1 and len(out) > 1:
            del out[at]
        else:
            out[at:at] = out[at: at + 5] if kind == 2 else rng.bytes(int(rng.integers(1, 90)))
    return bytes(out)


@pytest.mark.parametrize("seed", range(6))
def test_random_sessions_byte_for_byte(seed: int) -> None:
    script = random_script(np.random.default_rng(seed), 2.5)
    # The first frame after a boot may be the tail of one under way, which the emulator does not count.
    script += [rx(0, Stop()), *(rx(event.t_us, Stop()) for event in script if event.verb == "reboot")]
    script.sort(key=lambda event: (event.t_us, event.verb != "reboot", event.what != encode(Stop()).hex()))
    end = compare(script, 2_600_000)
    kinds = {type(m) for m in Decoder().feed(end.sent)}
    assert kinds == {Hello, Telemetry, Pong, FaultReport, DriveLimits}


def on_can(script: list[Event], rng: np.random.Generator, node: int) -> list[Event]:
    """The script's whole frames as CAN frames of the node; some unknown, too short, or of another node."""
    out = []
    for event in script:
        if event.verb != "rx":
            out.append(event)
            continue
        for message in Decoder().feed(b"\0" + bytes.fromhex(event.what)):
            (frame,) = CanCodec(node).encode(message)
            if rng.random() < 0.25:
                frame = frame._replace(can_id=int(rng.choice([node << 5 | 22, node + 1 << 5, node << 5 | 31])))
            elif rng.random() < 0.25:
                frame = frame._replace(data=(frame.data + b"\1")[:8] if rng.random() < 0.5 else frame.data[:-1])
            out.append(Event(event.t_us, "rx", as_bytes((frame,)).hex()))
    return out


@pytest.mark.parametrize("seed", range(4))
def test_random_sessions_on_can_byte_for_byte(seed: int) -> None:
    rng = np.random.default_rng(seed)
    end = compare(on_can(random_script(rng, 2.5), rng, 3), 2_600_000, 3)
    assert end.dropped[0] == 0 < end.dropped[2]
    # every Heartbeat, Hello and part of a Telemetry is there
    assert {int.from_bytes(end.sent[:2], "big") >> 5} == {3}


def test_readings_beyond_their_field_are_invalid_on_can() -> None:
    script = [Event(0, "set", "knee_hall", LOST), Event(0, "set", "motor_cdegc", 2_500)]
    end = compare(script, 4_000, 3)
    assert np.isnan(heard(end, Telemetry, 3)[0].knee_hall_rad)


def split(sent: bytes) -> list[CanFrame]:
    """leg_host's CAN frames of a stream, by the lengths of leg.dbc."""
    lengths, frames = {8: 6, 9: 7, 16: 6, 19: 6, 20: 7}, []
    while sent:
        can_id = int.from_bytes(sent[:2], "big")
        size = lengths.get(can_id & 31, 8)
        frames.append(CanFrame(can_id, sent[2: 2 + size]))
        sent = sent[2 + size:]
    return frames


def test_the_most_negative_torque_is_beyond_the_limit() -> None:
    frame = b"\x01\x00\x00\x00\x00\x00\x80"
    stuffed = cobs_by_hand(frame + crc_ccitt_false(frame).to_bytes(2, "little"))
    end = compare([rx(0, Arm(100)), Event(500, "rx", stuffed.hex())], 4_000)
    (report,) = heard(end, FaultReport)
    assert report.fault == Fault.COMMAND_LIMIT and np.isnan(report.value) and end.torque_unm == 0
