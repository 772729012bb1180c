"""The CAN codec: parts that are missing, doubled, late or foreign are counted and never joined into a message."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import FaultReport, Hello, Message, Pong, Telemetry
from drivers.can_codec import CanCodec
from drivers.can_frame import CanFrame
from drivers.protocol import Ping, TorqueCommand

TELEMETRY = Telemetry(7, 4000, 1, 0, 0.5, -0.25, 0.5, 0.125, 24.0, 30.5, 0.125)
HELLO = Hello(1, 0x1234ABCD, 500, 50.0, 2.0, 1000)


def frames(*messages: Message, node: int = 0) -> list[CanFrame]:
    return [frame for message in messages for frame in CanCodec(node).encode(message)]


angles = st.one_of(st.just(math.nan), st.integers(-(2**27) + 1, 2**27 - 1).map(lambda n: n / 1e6))


@settings(max_examples=200, deadline=None)
@given(seq=st.integers(0, 65535), tick=st.integers(0, 2**32 - 1), faults=st.integers(0, 2047), knee=angles, hall=angles,
       current=angles, state=st.integers(0, 2), node=st.integers(0, 63))
def test_any_telemetry_comes_back(seq: int, tick: int, faults: int, knee: float, hall: float, current: float,
                                  state: int, node: int) -> None:
    sent = replace(TELEMETRY, seq=seq, tick_us=tick, faults=faults, knee_rad=knee, knee_hall_rad=hall,
                   current_a=current, state=state)
    assert [str(m) for m in CanCodec(node).feed(frames(sent, node=node))] == [str(sent)]


@pytest.mark.parametrize("message", [
    replace(HELLO, gear_ratio=math.nan), Pong(1, 2**32 - 5, 15), FaultReport(77, 1 << 8, 3 << 8, math.nan),
    FaultReport(2**32 - 1, 1, 1, 100.25)], ids=str)
def test_messages_come_back(message: Message) -> None:
    assert [str(m) for m in CanCodec(5).feed(frames(message, node=5))] == [str(message)]


@pytest.mark.parametrize("part", range(4))
def test_telemetry_that_lacks_a_part_is_lost_whole_and_counted(part: int) -> None:
    codec, sent = CanCodec(), [replace(TELEMETRY, seq=k) for k in range(3)]
    wire = frames(*sent)
    del wire[4 + part]
    assert codec.feed(wire) == [sent[0], sent[2]] and codec.lost == 1 and codec.bad_crc == (1 if part else 3)


WIRE, LATER = frames(TELEMETRY), frames(replace(TELEMETRY, seq=8, knee_rad=1.0))
OTHERS: list[Message] = [Pong(1, 2, 22), FaultReport(5, 1, 1, 7.0)]


@pytest.mark.parametrize("arrived, got, bad", [
    ([*WIRE[:2], *LATER[2:]], [], 2), ([*WIRE[:2], WIRE[1], *WIRE[2:], WIRE[3]], [TELEMETRY], 2),
    (WIRE[2:] + frames(HELLO)[1:] + WIRE, [TELEMETRY], 0),
    ([WIRE[0], *frames(*OTHERS), *WIRE[1:]], [*OTHERS, TELEMETRY], 0)],
    ids=["parts of two periods", "a part twice", "tail of a message under way", "other messages in between"])
def test_parts_are_joined_only_where_they_belong(arrived: list[CanFrame], got: list[Message], bad: int) -> None:
    codec = CanCodec()
    assert codec.feed(arrived) == got and codec.bad_crc == bad


def test_frames_of_others_are_passed_over_and_wrong_ones_counted() -> None:
    codec = CanCodec(2)
    assert codec.feed(frames(TELEMETRY, node=3)) == [] and not codec.bad_crc + codec.bad_length + codec.unknown
    codec.feed(frames(TELEMETRY, node=2))
    codec.feed([CanFrame(2 << 5 | 31, b""), CanFrame(2 << 5 | 12, b"\0" * 7), CanFrame(2 << 5 | 13, b"\0" * 8)])
    assert (codec.bad_crc, codec.bad_length, codec.unknown) == (1, 1, 1)


def test_what_does_not_fit() -> None:
    for bad in (TorqueCommand(0, math.nan), TorqueCommand(0, math.inf), TorqueCommand(65536, 0.0), Ping(-1)):
        with pytest.raises(ValueError, match=r"cannot be sent|does not fit"):
            CanCodec().encode(bad)
    (back,) = CanCodec().feed(frames(replace(TELEMETRY, knee_rad=200.0)))
    assert isinstance(back, Telemetry) and math.isnan(back.knee_rad)
    with pytest.raises(ValueError, match="node 64"):
        CanCodec(64)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=60))
def test_noise_never_raises_and_the_next_message_is_read(noise: list[tuple[int, bytes]]) -> None:
    codec = CanCodec(1)
    codec.feed([CanFrame(can_id, data) for can_id, data in noise])
    assert codec.feed(frames(HELLO, node=1))[-1] == HELLO
