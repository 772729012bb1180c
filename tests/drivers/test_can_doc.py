"""Section 10 of firmware_protocol.md against leg.dbc, the codec, and itself. Bits are packed here a second time."""

import re
from typing import NamedTuple

import cantools
import pytest

from drivers import protocol
from drivers.can_codec import PARTS, CanCodec
from drivers.can_frame import CanFrame
from tests.support.paths import ROOT

TEXT = (ROOT / "firmware_protocol.md").read_text().split("\n## 10.")[1]
DBC = cantools.database.load_file(ROOT / "drivers" / "leg.dbc")
FIELD = re.compile(r"^  - `(\d+)\|(\d+)` - (\w+) = (0x[0-9A-F]+) = (\S+)")
FRAME = re.compile(r"^- frame: `([0-9A-F]{3}) \[(\d)\]((?: [0-9A-F]{2})*)`")
IDENTIFIER = re.compile(r"^- id = (0x[0-9A-F]{3}) = node (\d+), message (\d+)")


class Example(NamedTuple):
    can_id: int
    node: int
    number: int
    fields: list[tuple[int, int, str, int, str]]
    frame: CanFrame


def examples() -> dict[str, Example]:
    found = {}
    for part in TEXT.split("### Examples on CAN")[1].split("\n#### ")[1:]:
        lines = part.splitlines()
        can_id, node, number = next(m.groups() for line in lines if (m := IDENTIFIER.match(line)))
        fields = [(int(m[1]), int(m[2]), m[3], int(m[4], 16), m[5]) for line in lines if (m := FIELD.match(line))]
        cid, size, data = next(m.groups() for line in lines if (m := FRAME.match(line)))
        frame = CanFrame(int(cid, 16), bytes.fromhex(data))
        found[lines[0].strip()] = Example(int(can_id, 16), int(node), int(number), fields, frame)
        assert int(size) == len(frame.data)
    return found


EXAMPLES = examples()


def messages() -> dict[str, tuple[protocol.Message, list[CanFrame]]]:
    """Every message from the physical values printed, tags aside, and its frames as printed."""
    found = {}
    for kind, parts in PARTS.items():
        printed = {field: value for name in parts for _, _, field, _, value in EXAMPLES[name].fields}
        printed.pop("tag", None)
        if kind is protocol.Pong:
            printed["tx_tick_us"] = str(int(printed["rx_tick_us"]) + int(printed.pop("turnaround_us")))
        if kind is protocol.FaultReport:
            printed["fault"] = str(1 << int(printed["fault"]))
        values = {field: float(text) if "." in text or text == "nan" else int(text) for field, text in printed.items()}
        if "estop_open" in values:  # bits of faults, apart from the others on CAN
            values["faults"] += values.pop("position_limit") * 2**12 + values.pop("estop_open") * 2**15
        found[kind.__name__] = kind(**values), [EXAMPLES[name].frame for name in parts]
    return found


MESSAGES = messages()


def test_every_frame_has_an_example_and_every_message_its_frames() -> None:
    assert set(EXAMPLES) == {m.name for m in DBC.messages}
    assert {name for parts in PARTS.values() for name in parts} == set(EXAMPLES)
    assert set(MESSAGES) == {kind.__name__ for kind in protocol.TYPES} | {"Heartbeat"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_agrees_with_itself(name: str) -> None:
    can_id, node, number, fields, frame = EXAMPLES[name]
    assert can_id == frame.can_id == node * 32 + number
    word = 0
    for start, length, _, raw, value in fields:
        assert raw < 2**length
        word |= raw << start
        numeral = raw - 2**length if raw >> (length - 1) and value.startswith("-") else raw
        if "." not in value and value != "nan":
            assert numeral == int(value)
    assert frame.data == word.to_bytes(len(frame.data), "little")


@pytest.mark.parametrize("name", MESSAGES)
def test_codec_encodes_and_decodes_the_example(name: str) -> None:
    message, frames = MESSAGES[name]
    assert list(CanCodec(3).encode(message)) == frames
    assert list(map(str, CanCodec(3).feed(frames))) == [str(message)]  # NaN is no equal of itself


def test_message_table_is_the_dbc() -> None:
    rows = re.findall(r"^\| (\d+) \| (\w+) \| (up|down) \| (\d) \|", TEXT, re.M)
    assert {(int(number), name, int(size), direction) for number, name, direction, size in rows} == {
        (m.frame_id, m.name, m.length, "up" if m.senders == ["LEG"] else "down") for m in DBC.messages}
    assert all(EXAMPLES[m.name].number == m.frame_id and not m.is_extended_frame for m in DBC.messages)


def test_field_table_is_the_dbc() -> None:
    name, seen = "", set()
    rows = re.findall(r"^\| (\w*) ?\| (\w+) \| (\d+)\\\|(\d+) \| (yes|no) \| ([^|]+) \| ([^|]+) \|$", TEXT, re.M)
    for message, field, start, length, signed, unit, invalid in rows:
        name = message or name
        s = DBC.get_message_by_name(name).get_signal_by_name(field)
        factor = re.match(r"[\d.e-]+", unit)
        assert (s.start, s.length, s.byte_order, s.is_signed, s.scale) == (
            int(start), int(length), "little_endian", signed == "yes", float(factor[0]) if factor else 1.0)
        if s.unit:
            assert unit.split(maxsplit=1)[1] == s.unit
        marks = [number % 2**s.length for number, text in (s.choices or {}).items() if str(text) == "invalid"]
        assert marks == ([] if invalid == "-" else [int(invalid, 16)])
        seen.add((name, field))
    assert seen == {(m.name, s.name) for m in DBC.messages for s in m.signals}


def test_fields_do_not_overlap_and_examples_name_all_of_them() -> None:
    for m in DBC.messages:
        used = [bit for s in m.signals for bit in range(s.start, s.start + s.length)]
        assert len(used) == len(set(used)) <= 8 * m.length
        assert [(s.start, s.length, s.name) for s in sorted(m.signals, key=lambda s: s.start)] == [
            row[:3] for row in EXAMPLES[m.name].fields]


def test_longest_frame_is_as_the_document_says() -> None:
    # CAN 2.0A: 44 bits and the data, a stuff bit after every four of the first 34 + data, three bits of gap
    bits = 44 + 64 + (34 + 64 - 1) // 4 + 3
    assert f"takes at most {bits} bits" in TEXT
    assert f"takes {round(4 * 500 * bits / 1e4)} %" in " ".join(TEXT.split())
