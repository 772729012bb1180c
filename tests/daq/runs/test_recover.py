"""Files cut at any byte: read to the last whole record, recovered, never a traceback."""

from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from daq import InputError
from daq.runs import RunWriter, read_run, recover
from tests.support.runs import records


@pytest.fixture(scope="module")
def whole(module_path: Path) -> bytes:
    path = module_path / "r.mcap"
    writer = RunWriter(path, {"rig.toml": "abc"}, {"a": "b"})
    for i in range(6):
        writer.add("/leg/command", i, i, 0.25 * i, i)
        if i % 2:
            writer.event(i, "mark", f"after {i}")  # an event ends the chunk
    writer.close()
    return path.read_bytes()


def test_cut_at_any_byte(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    counts = []
    edges = [start for _, start, _ in records(whole)]
    data_end = next(end for opcode, _, end in records(whole) if opcode == Opcode.DATA_END)
    # every byte near where a record begins, and of others, and of the index after the data, which is not read, some
    near = {size for edge in edges if edge <= data_end for size in range(edge - 12, edge + 13)}
    for size in sorted({*near, *range(0, len(whole), 7), len(whole) - 1, len(whole)} - set(range(-12, 0))):
        path.write_bytes(whole[:size])
        try:
            raw = read_run(path)
        except InputError as error:
            assert size < 8, error
            counts.append(0)
            continue
        commands = raw.streams["/leg/command"]
        assert (commands["torque_nm"] == 0.25 * np.arange(commands.size)).all()
        assert [e.text for e in raw.events] == [f"after {i}" for i in (1, 3, 5)][:len(raw.events)]
        assert set(raw.files.values()) <= {"abc"}
        counts.append(raw.messages)
        assert raw.complete == (size == len(whole))
    assert counts == sorted(counts) and list(dict.fromkeys(counts)) == [0, 3, 6, 9]


def test_recovered_files_are_whole_at_a_sample_of_cuts(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    for size in [*range(8, len(whole), 61), len(whole)]:
        path.write_bytes(whole[:size])
        out = tmp_path / f"{size}.mcap"
        report = recover(path, out)
        before, after = read_run(path), read_run(out)
        assert after.complete
        assert report.complete == before.complete == (size == len(whole))
        assert report.messages == before.messages == after.messages
        assert (after.files, after.facts, after.events) == (before.files, before.facts, before.events)
        for topic, values in before.streams.items():
            assert (after.streams[topic] == values).all()
        with open(out, "rb") as file:
            summary = make_reader(file).get_summary()
        assert summary.statistics.message_count == report.messages


def test_nothing_is_overwritten_and_nothing_made_of_nothing(whole: bytes, tmp_path: Path, path: Path) -> None:
    (path).write_bytes(whole)
    with pytest.raises(InputError, match="exists already"):
        recover(path, path)
    (tmp_path / "t.mcap").write_text("hello, world")
    with pytest.raises(InputError, match="not an MCAP file"):
        recover(tmp_path / "t.mcap", tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_noise_after_the_last_record_ends_the_reading(whole: bytes, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for size in range(40, len(whole), 97):
        (tmp_path / "n.mcap").write_bytes(whole[:size] + rng.bytes(200))
        assert read_run(tmp_path / "n.mcap").messages <= 9
