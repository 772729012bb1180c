"""moteus' frames: the example of its documentation, byte for byte, and whatever else comes."""

import math
import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.can_frame import CanFrame, padded
from drivers.fdcanusb_link import FdcanusbCodec, line_of
from drivers.multiplex import READ, REPLY, STREAM_TO_CLIENT, Kind, Register, counted, parse, read, scaled, stream, write


def test_the_documented_command_is_what_is_built() -> None:
    """docs/protocol/can.md of mjbots/moteus, "Example"."""
    built = (write(Kind.INT8, Register.MODE, [10]) + write(Kind.INT16, 0x020, [0x60, 0x120, -176])
             + read(Kind.INT16, Register.MODE, 4) + read(Kind.INT8, Register.VOLTAGE, 3))
    assert built.hex() == "01000a07206000200150ff140400130d"
    assert line_of(CanFrame(0x8001, built, True, True)) == b"can send 8001 01000a07206000200150ff140400130d BF\n"


def test_the_documented_answer_is_understood() -> None:
    codec = FdcanusbCodec()
    (frame,) = codec.feed(b"OK\r\nrcv 100 2404000a005000000170ff230d181400\r\n")
    assert (frame.can_id, codec.bad) == (0x100, 0)
    first, second = parse(frame.data)
    assert (first.op, first.start, first.values) == (REPLY, Register.MODE, (10, 80, 256, -144))
    assert (second.start, second.values) == (Register.VOLTAGE, (24, 20, 0))
    assert scaled(-144, Kind.INT16, {Kind.INT16: 0.01}) == pytest.approx(-1.44)


@given(st.sampled_from(list(Kind)), st.integers(0, 0x300), st.integers(1, 9), st.data())
def test_what_is_written_is_read_back(kind: Kind, start: int, count: int, data: st.DataObject) -> None:
    most = {Kind.INT8: 2**7, Kind.INT16: 2**15, Kind.INT32: 2**31}
    one = st.floats(width=32, allow_nan=False) if kind == Kind.F32 else st.integers(-most[kind], most[kind] - 1)
    values = tuple(data.draw(one) for _ in range(count))
    (part,) = parse(padded(write(kind, start, values), 0x50))
    assert (part.kind, part.start, part.values) == (kind, start, values)
    (asked,) = parse(read(kind, start, count))
    assert (asked.op, asked.start, len(asked.values)) == (READ, start, count)


@given(st.binary(max_size=64))
def test_noise_is_refused_or_read_never_worse(data: bytes) -> None:
    with suppress(ValueError):
        assert all(len(part.values) <= 64 for part in parse(data))


@given(st.lists(st.binary(max_size=40), max_size=8))
def test_noise_on_the_adapters_line_is_counted(chunks: list[bytes]) -> None:
    codec = FdcanusbCodec()
    for chunk in [*chunks, b"\n"]:
        codec.feed(chunk)
    assert len(codec.feed(b"rcv 100 2100 E B F\n")) == 1


def test_numbers_that_do_not_fit_stand_at_the_end_of_their_type() -> None:
    lsb = {Kind.INT8: 0.01, Kind.INT16: 1e-4}
    assert counted(5.0, Kind.INT8, lsb) == 127 and counted(-5.0, Kind.INT8, lsb) == -127
    assert counted(math.nan, Kind.INT16, lsb) == -32768 and math.isnan(scaled(-32768, Kind.INT16, lsb))
    assert struct.unpack("<f", write(Kind.F32, 1, [0.5])[2:])[0] == 0.5


def test_the_console_travels_in_a_frame() -> None:
    (part,) = parse(padded(stream(STREAM_TO_CLIENT, b"12\r\n"), 0x50))
    assert part.data == b"12\r\n"
    with pytest.raises(ValueError, match="do not fit"):
        padded(bytes(65), 0)
