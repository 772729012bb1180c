"""The document is the truth: its tables and hex examples against the codec, both ways."""

import re
import struct
from dataclasses import fields

import pytest

from drivers import protocol
from drivers.protocol import Decoder, Fault, encode
from tests.support.paths import ROOT
from tests.support.wire_by_hand import cobs_by_hand, crc_ccitt_false

TEXT = (ROOT / "firmware_protocol.md").read_text()
FIELD = re.compile(r"^\s*- `([0-9A-F ]+)` - (\w+) = (0x[0-9A-F]+)(?: = (\S+))?")
FRAME = re.compile(r"^- frame: `([0-9A-F ]+)`")
SIZE = {"u8": "B", "u16": "H", "u32": "I", "i16": "h", "i32": "i"}


def examples() -> dict[str, dict]:
    """name -> {fields: [(name, bytes, value text)], crc, frame}."""
    found = {}
    for part in TEXT.split("## 9. Examples")[1].split("\n## 10.")[0].split("\n### ")[1:]:
        lines = part.splitlines()
        rows = [m.groups() for line in lines if (m := FIELD.match(line))]
        frame = next(m.group(1) for line in lines if (m := FRAME.match(line)))
        found[lines[0].strip()] = {"rows": rows, "frame": bytes.fromhex(frame)}
    return found


EXAMPLES = examples()


def message_of(name: str) -> protocol.Message:
    """The message from the physical values printed in the bullets alone."""
    kind = getattr(protocol, name)
    printed = {field: value for _, field, _, value in EXAMPLES[name]["rows"] if field not in ("type", "crc")}
    assert list(printed) == [f.name for f in fields(kind)]
    numbers = [int(text) if scale is None else float(text)
               for text, (_, scale) in zip(printed.values(), protocol.LAYOUT[kind])]
    return kind(*numbers)


def test_every_message_has_an_example() -> None:
    assert set(EXAMPLES) == {kind.__name__ for kind in protocol.TYPES}


def test_check_value_of_the_crc_stands_in_the_document() -> None:
    assert crc_ccitt_false(b"123456789") == 0x29B1
    assert "`0x29B1`" in TEXT


@pytest.mark.parametrize("name", EXAMPLES)
def test_example_agrees_with_itself(name: str) -> None:
    rows = EXAMPLES[name]["rows"]
    data = [bytes.fromhex(raw) for raw, *_ in rows]
    for raw, (_, _, number, _) in zip(data, rows):
        assert number == f"0x{int.from_bytes(raw, 'little'):0{2 * len(raw)}X}"
    payload, (_, last, crc, _) = b"".join(data[:-1]), rows[-1]
    assert last == "crc" and int(crc, 16) == crc_ccitt_false(payload)
    assert EXAMPLES[name]["frame"] == cobs_by_hand(payload + data[-1])


@pytest.mark.parametrize("name", EXAMPLES)
def test_codec_encodes_and_decodes_the_example(name: str) -> None:
    assert encode(message_of(name)).hex(" ") == EXAMPLES[name]["frame"].hex(" ")
    assert list(map(str, Decoder().feed(EXAMPLES[name]["frame"]))) == [str(message_of(name))]  # as NaN has no equal


def table_rows(title: str) -> list[list[str]]:
    section = TEXT.split(f"### {title}\n")[1].split("\n#")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines()
            if line.startswith("|")][2:]


@pytest.mark.parametrize("name", ["Telemetry", "Hello", "Pong", "FaultReport"])
def test_field_tables_are_the_layout(name: str) -> None:
    kind = getattr(protocol, name)
    rows = table_rows(f"0x{protocol.TYPES[kind]:02X} {name}")
    assert [row[1] for row in rows] == [f.name for f in fields(kind)]
    offset = 1
    for position, ((code, scale), row) in enumerate(zip(protocol.LAYOUT[kind], rows)):
        assert int(row[0]) == offset and SIZE[row[2]] == code
        size = struct.calcsize(code)
        offset += size
        assert scale is None or row[3].split()[0] == {1e-6: "1e-6", 1e-3: "1e-3", 0.01: "0.01"}[scale]
        if scale is None or (kind, position) in protocol.NO_SENTINEL:
            assert row[4] == "-"
        else:
            assert int(row[4], 16) == protocol.SENTINEL[code] % 2**(8 * size)


def test_message_table_gives_the_sizes() -> None:
    for row in re.findall(r"^\| (0x\d\d) \| (\w+) \| (up|down) \| (\d+) \| (\d+) \|", TEXT, re.M):
        number, name, direction, payload, frame = row
        assert protocol.TYPES[getattr(protocol, name)] == int(number, 16)
        assert (direction == "up") == (int(number, 16) >= 0x80)
        assert len(EXAMPLES[name]["frame"]) == int(frame)
        assert sum(len(bytes.fromhex(r[0])) for r in EXAMPLES[name]["rows"][:-1]) == int(payload)


def test_fault_table_gives_the_bits() -> None:
    section = TEXT.split("| bit | fault |")[1].split("\n## 9.")[0]
    rows = re.findall(r"^\| (\d+) \| ([A-Z_]+)", section, re.M)
    assert {name: 1 << int(bit) for bit, name in rows} == {f.name: f.value for f in Fault}
