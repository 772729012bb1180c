"""Run files: their bytes, what a viewer sees, what is left after a kill."""

import errno
import os
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from daq import InputError, WorkError
from daq.runs import Note, RunWriter, read_run
from daq.runs.mcap_run import FLUSH_MESSAGES
from daq.runs.streams import CLOCK, COMMAND, IMU_STREAM, STREAMS, TELEMETRY, pack_note, unpack_note
from tests.support.paths import ROOT

FILES = {"rig.toml": "[mechanism]\n", "plan.csv": "time_s,tau2_cmd_nm\n"}


@pytest.fixture
def written(path: Path) -> Path:
    """300 samples of each."""
    writer = RunWriter(path, FILES, {"started_unix_ns": "7"})
    writer.config(90, "firmware", '{"boot_id": 5}')
    for i in range(300):
        t = 100 + i * 1_000_000
        writer.add("/leg/telemetry", t, t, 0.1 * i, np.nan, -0.5, 1.5, 24.0, 31.5, 0.25, i, 5, i % 65536, 3, 1)
        writer.add("/imu", t, t, t + 9, i, 1, -2, 3, -4, 5, -32768, i == 0)
    writer.event(10**9, "limit q2_rad", "Grüße: angle 2.7")
    writer.close()
    writer.close()
    return path


def test_everything_comes_back(written: Path) -> None:
    raw = read_run(written)
    assert raw.complete and raw.messages == 602
    assert raw.files == FILES and raw.facts["started_unix_ns"] == "7"
    assert raw.events == [Note(10**9, "limit q2_rad", "Grüße: angle 2.7")]
    assert raw.config == [Note(90, "firmware", '{"boot_id": 5}')]
    telemetry = raw.streams["/leg/telemetry"]
    np.testing.assert_allclose(telemetry["knee_rad"], 0.1 * np.arange(300))
    assert np.isnan(telemetry["pivot_hall_rad"]).all() and raw.streams["/leg/clock"].size == 0
    assert raw.streams["/imu"][-1].tolist()[1:] == (299_000_100, 299_000_109, 299, 1, -2, 3, -4, 5, -32768, 0)


def test_payload_bytes_are_cdr() -> None:
    data = COMMAND.packer.pack(b"\x00\x01\x00\x00", 258, 1.0, 7)
    assert data.hex(" ") == "00 01 00 00 02 01 00 00 00 00 00 00 00 00 00 00 00 00 f0 3f 07 00"
    note = pack_note(Note(1, "ab", "c"))
    assert note.hex(" ") == ("00 01 00 00 01 00 00 00 00 00 00 00 03 00 00 00 61 62 00 00 02 00 00 00 63 00")
    for text in ("", "a", "abc", "Grüße", "x" * 999):
        assert unpack_note(pack_note(Note(-5, text, text[::-1]))) == Note(-5, text, text[::-1])


@pytest.mark.parametrize("stream", STREAMS.values(), ids=list(STREAMS))
def test_no_field_needs_padding(stream) -> None:
    """CDR aligns each field to its size; a packed struct is the same only when that adds nothing."""
    at = 0
    for field in stream.fields:
        size = np.dtype(field.ros).itemsize
        assert at % size == 0, field
        at += size
    assert stream.dtype.itemsize == stream.packer.size == 4 + at


def test_a_viewer_finds_index_schemas_and_texts(written: Path) -> None:
    """Through the library's own indexed reader, as Foxglove and PlotJuggler read."""
    with open(written, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 602
        channels, schemas = summary.channels.values(), {s.name: s for s in summary.schemas.values()}
        assert {c.topic for c in channels} == {*STREAMS, "/events", "/config"}
        assert {c.message_encoding for c in channels} == {"cdr"}
        assert {s.encoding for s in schemas.values()} == {"ros2msg"}
        lines = schemas["legid_msgs/msg/LegTelemetry"].data.decode().splitlines()
        assert [line.split()[:2] for line in lines] == [[f.ros, f.name] for f in TELEMETRY.fields]
        assert [a.name for a in reader.iter_attachments()] == list(FILES)
        first = next(message for _, channel, message in reader.iter_messages("/imu"))
        assert struct.unpack_from("<q", first.data, 4) == (first.log_time,)


def test_a_run_is_never_overwritten(written: Path) -> None:
    for path, said in ((written, "exists already"), (written.parent / "nowhere" / "r.mcap", "No such file")):
        with pytest.raises(InputError, match=said):
            RunWriter(path, {})


@pytest.mark.parametrize("data, said", [(b"", "is empty"), (b"time_s,q2_rad\n0,1\n", "is not an MCAP file"),
                                            (b"\x89MC", "is not an MCAP file")])
def test_what_is_no_run_file_is_refused(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "r.mcap").write_bytes(data)
    with pytest.raises(InputError, match=said):
        read_run(tmp_path / "r.mcap")
    with pytest.raises(InputError, match="No such file"):
        read_run(tmp_path / "none.mcap")


def test_a_damaged_chunk_costs_only_itself(written: Path) -> None:
    data = bytearray(written.read_bytes())
    at = data.find(struct.pack("<qd", 100 + 200_000_000, 0.1 * 200))
    assert at > 0
    data[at] ^= 0xFF
    written.write_bytes(data)
    raw = read_run(written)
    assert raw.damaged_chunks == 1 and 602 - FLUSH_MESSAGES <= raw.messages < 602


def test_a_full_disk_is_said_in_one_line(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = RunWriter(path, {})
    monkeypatch.setattr(os, "fdatasync", full)
    writer.event(0, "start", "")
    with pytest.raises(WorkError, match=r"r\.mcap: cannot be written \(No space left on device\)"):
        writer.close()
    writer.close()
    assert read_run(path).events[0].kind == "start"


KILLED = """
import sys
from daq.runs import RunWriter
writer = RunWriter(sys.argv[1], {"rig.toml": "x"})
i = 0
while True:
    writer.add("/leg/command", i, i, 0.5, i % 65536)
    i += 1
    if i % 1000 == 0:
        print(i, flush=True)
"""


def test_a_killed_writer_leaves_all_but_the_last_few(path: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True,
                              cwd=ROOT)
    said = [int(writer.stdout.readline()) for _ in range(12)]
    os.kill(writer.pid, signal.SIGKILL)
    rest = writer.stdout.read().split()
    assert writer.wait() == -signal.SIGKILL
    written = int(rest[-1]) if rest else said[-1]
    raw = read_run(path)
    kept = raw.streams["/leg/command"]
    assert not raw.complete and raw.files == {"rig.toml": "x"}
    assert kept.size >= written - FLUSH_MESSAGES  # the texts before them count as one each
    assert (kept["host_ns"] == np.arange(kept.size)).all()


def test_probe_and_sample_schemas_carry_raw_ticks() -> None:
    assert {"rx_tick_us", "tx_tick_us", "boot_id"} <= {f.name for f in CLOCK.fields}
    assert {"index", "gap_before", "gyro_x", "accel_z"} <= {f.name for f in IMU_STREAM.fields}
