"""The codec against payload bytes written out by hand from the field tables, and against noise."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import Hello, Message, Telemetry, describe_faults
from drivers.protocol import MAX_FRAME, Arm, Decoder, Fault, TorqueCommand, encode
from tests.support.wire_by_hand import crc_ccitt_false

TELEMETRY = Telemetry(0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
HELLO = Hello(1, 7, 500, 50.0, 2.0, 1000)


@pytest.mark.parametrize("message, payload", [
    (TorqueCommand(0xFFFF, -1e-6), "01 FF FF FF FF FF FF"),
    (replace(TELEMETRY, knee_rad=math.pi, bus_v=math.nan, motor_degc=math.nan, current_a=math.nan),
     "81 00 00 00 00 00 00 00 00 00"  # type, seq, tick, state, faults
     "D9 EF 2F 00"  # 3141593 = 0x002FEFD9
     "00 00 00 00 00 00 00 00"
     "00 00 00 80"  # invalid i32
     "FF FF 00 80"  # invalid u16, invalid i16
     "00 00 00 00"),
], ids=lambda v: type(v).__name__ if not isinstance(v, str) else "")
def test_payload_by_hand(message: Message, payload: str) -> None:
    assert cobs.decode(encode(message)[:-1])[:-2] == bytes.fromhex(payload)


angles = st.one_of(st.just(math.nan), st.integers(-(2**31) + 1, 2**31 - 1).map(lambda n: n / 1e6))


@settings(max_examples=200, deadline=None)
@given(seq=st.integers(0, 65535), tick=st.integers(0, 2**32 - 1), faults=st.integers(0, 2047), knee=angles,
       current=angles, cuts=st.lists(st.integers(1, 37), max_size=4))
def test_any_telemetry_in_any_pieces_comes_back(seq: int, tick: int, faults: int, knee: float, current: float,
                                                cuts: list[int]) -> None:
    sent = replace(TELEMETRY, seq=seq, tick_us=tick, faults=faults, knee_rad=knee, current_a=current)
    frame, decoder = encode(sent), Decoder()
    got = [m for a, b in pairwise([0, *sorted(set(cuts)), len(frame)]) for m in decoder.feed(frame[a:b])]
    assert [str(m) for m in got] == [str(sent)]  # str: NaN equals itself


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_noise_never_raises_and_the_next_frame_is_read(noise: bytes) -> None:
    decoder = Decoder()
    decoder.feed(noise)
    assert decoder.feed(b"\0" + encode(HELLO))[-1] == HELLO


def test_no_single_changed_byte_is_taken_for_a_message() -> None:
    frame = encode(replace(TELEMETRY, seq=9, knee_rad=0.5))
    for position in range(len(frame) - 1):
        for change in range(1, 256):
            broken = bytearray(frame)
            broken[position] ^= change
            decoder = Decoder()
            decoder.feed(encode(HELLO))
            assert decoder.feed(bytes(broken)) == [] and decoder.bad_crc + decoder.bad_length


def framed(payload: bytes) -> bytes:
    return cobs.encode(payload + crc_ccitt_false(payload).to_bytes(2, "little")) + b"\0"


def test_counters_name_what_was_dropped() -> None:
    decoder = Decoder()
    for chunks, counts in (
            ((encode(HELLO), bytes.fromhex("04 03 93 D2 00")), (1, 0, 0)),  # Stop with a wrong CRC
            ((b"\x41" * 200, b"\x41" * 200 + b"\0"), (1, 1, 0)),
            ((framed(b"\x7e"),), (1, 1, 1)),  # a type nobody knows
            ((framed(b"\x02\x01"),), (1, 2, 1))):  # Arm, one byte short
        for chunk in chunks:
            decoder.feed(chunk)
        assert (decoder.bad_crc, decoder.bad_length, decoder.unknown) == counts


def test_the_tail_of_a_frame_under_way_is_not_an_error() -> None:
    decoder = Decoder()
    assert decoder.feed(encode(TELEMETRY)[11:] + encode(HELLO)) == [HELLO]
    assert (decoder.bad_crc, decoder.bad_length) == (0, 0)


def test_lost_frames_are_counted_over_the_wrap_and_forgotten_at_a_reboot() -> None:
    decoder = Decoder()
    for seq, hello, lost in ((65533, b"", 0), (65534, b"", 0), (1, b"", 2),  # 65535 and 0 are missing
                             (0, encode(HELLO), 2), (1, encode(HELLO), 2),  # the hello of every second changes nothing
                             (3, encode(HELLO), 3)):
        decoder.feed(hello + encode(replace(TELEMETRY, seq=seq)))
        assert decoder.lost == lost


@pytest.mark.parametrize("message", [
    TorqueCommand(0, math.nan), TorqueCommand(0, math.inf), TorqueCommand(0, 3000.0), TorqueCommand(65536, 0.0),
    Arm(-1), replace(TELEMETRY, knee_rad=-2147.483648), replace(TELEMETRY, torque_cmd_nm=math.nan),
], ids=str)
def test_what_does_not_fit_is_refused(message: Message) -> None:
    with pytest.raises(ValueError, match=r"cannot be sent|does not fit|invalid"):
        encode(message)


def test_longest_frame_leaves_room_for_every_message() -> None:
    assert len(encode(TELEMETRY)) - 1 <= MAX_FRAME


def test_faults_have_names() -> None:
    assert describe_faults(Fault.WATCHDOG | Fault.OVERSPEED) == "watchdog, overspeed"
    assert describe_faults(1 << 14) == "bit 14"
    assert describe_faults(0) == "none"
