"""A run file that is not what was recorded says so, and says what is missing."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from daq import InputError
from daq.runs import RunWriter, read_run, recover
from daq.runs.mcap_run import FLUSH_MESSAGES
from tests.support.runs import records

CHUNKS, EACH = 4, FLUSH_MESSAGES


@pytest.fixture(scope="module")
def whole(module_path: Path) -> bytes:
    """Four chunks of IMU samples."""
    path = module_path / "r.mcap"
    writer = RunWriter(path, {"rig.toml": "lever_arm_m = 0.2"}, {"a": "b"})
    for i in range(CHUNKS * EACH):
        writer.add("/imu", i, i, i + 9, i, 1, 2, 3, 4, 5, 6, 0)
    writer.close()
    return path.read_bytes()


def chunk(data: bytes, number: int) -> tuple[int, int]:
    """Where one of the file's chunks starts and stops."""
    return [(a, b) for opcode, a, b in records(data) if opcode == Opcode.CHUNK][number]


CASES = {
    "removed": (1, lambda d, a, b: d[:a] + d[b:], 3 * EACH, f"{EACH} of {4 * EACH} messages are missing", True),
    "doubled": (1, lambda d, a, b: d[:b] + d[a:], 5 * EACH, f"{EACH} IMU samples are there twice", True),
    "broken": (1, lambda d, a, b: d[: b - 40] + bytes([d[b - 40] ^ 1]) + d[b - 39:], 3 * EACH,
               "1 damaged chunks left out", True),
    "cut": (2, lambda d, a, b: d[: (a + b) // 2], 2 * EACH, "its end is missing", False),
    "attachment": (0, lambda d, a, b: d.replace(b"lever_arm_m = 0.2", b"lever_arm_m = 0.3"), 4 * EACH,
                   "check sum of rig.toml inside it is wrong", True),
    "cut and removed": (1, lambda d, a, b: d[:a] + d[b: b + (b - a) // 2], EACH, "its end is missing", False),
}
"""A chunk that starts at a and stops at b, and the file d without it, or else damaged; what is left, what is said of
it, and whether that is said of the recovered file too."""


@pytest.mark.parametrize("number, broken, left, says, stays", CASES.values(), ids=CASES)
def test_what_is_missing_is_said_and_a_hole_stays_one(
        number: int, broken: Callable[[bytes, int, int], bytes], left: int, says: str, stays: bool, whole: bytes,
        tmp_path: Path) -> None:
    path, repaired = tmp_path / "r.mcap", tmp_path / "repaired.mcap"
    path.write_bytes(whole)
    assert read_run(path).damage == ()
    path.write_bytes(broken(whole, *chunk(whole, number)))
    raw = read_run(path)
    assert raw.streams["/imu"].size == left
    assert any(says in damage.text for damage in raw.damage), raw.damage
    recover(path, repaired)
    after = read_run(repaired)
    assert after.complete and after.streams["/imu"].size == left
    assert any(says in damage.text for damage in after.damage) == stays  # a run cut short is a shorter run


def test_a_hole_before_a_lost_end_is_seen_by_the_samples_own_count(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    a, b = chunk(whole, 1)
    path.write_bytes(whole[:a] + whole[b: chunk(whole, 3)[0]])
    recover(path, tmp_path / "repaired.mcap")
    for run in (path, tmp_path / "repaired.mcap"):
        assert any(f"{EACH} IMU samples are missing" in str(damage) for damage in read_run(run).damage)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_small_file_that_unpacks_to_a_gigabyte_is_refused(compression: CompressionType, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=1 << 30)
        writer.start()
        channel = writer.register_channel("/imu", "cdr", writer.register_schema("x", "ros2msg", b""))
        for k in range(90):
            writer.add_message(channel, k, bytes(1 << 20), k)
        writer.finish()
    data = path.read_bytes()
    if compression is CompressionType.ZSTD:
        assert len(data) < 20_000
        with pytest.raises(InputError, match="unpacks to more than"):
            read_run(path)
    a, _ = chunk(data, 0)
    at = a + 9 + 16  # behind the chunk's times stands the size that it claims
    path.write_bytes(data[:at] + struct.pack("<Q", 1000) + data[at + 8:])
    assert read_run(path).damaged_chunks == 1  # it claims less than it holds, and no more is unpacked


def test_a_flipped_digit_of_the_metadata_is_damage(tmp_path: Path) -> None:
    """Facts such as the start time have a check sum of their own; an earlier version's file, without it, is sound."""
    path = tmp_path / "run.mcap"
    RunWriter(path, {}, {"started_unix_ns": "1760000000000000000"}).close()
    assert read_run(path).damage == () and "crc32" not in read_run(path).facts
    data = path.read_bytes()
    path.write_bytes(data.replace(b"1760000000000000000", b"1760000000000000001"))
    (found,) = read_run(path).damage
    assert found.kind == "check_sum" and "metadata 'legid'" in found.text
    recover(path, tmp_path / "saved.mcap")
    assert "metadata 'legid'" in read_run(tmp_path / "saved.mcap").damage[0].text
    path.write_bytes(data.replace(b"crc32", b"crc00"))
    assert read_run(path).damage == ()
