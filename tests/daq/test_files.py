"""Files are written whole or not at all, and never over a measurement."""

import errno
import gzip
import os
import re
import resource
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from daq import InputError, replacing_anything, write_file
from daq.files import kind_of_bytes, new_run
from tests.support.paths import DEMO_RIG, ROOT

OURS = b'{\n  "schema": "legid.fit/1",\n  "model": "leg2"\n}\n'
RUNS = {
    "MCAP": b"\x89MCAP0\r\nrest", "our CSV": b"time_s,q2_rad,tau2_nm\n0.0,0.1,0.2\n0.01,0.1,0.2\n",
    "packed CSV": gzip.compress(b"time_s,q2_rad\n0.0,0.1\n"), "another's CSV": b"t;angle\r\n0,00;1,5\r\n0,01;1,6\r\n",
    "MATLAB": b"MATLAB 5.0 MAT-file, Platform", "MATLAB 7.3": b"\x89HDF\r\n\x1a\n...",
    "Parquet": b"PAR1...time_s...PAR1",
    "ROS bag": b"#ROSBAG V2.0\n", "ROS 2 bag": b"SQLite format 3\0...",
}
WRITERS = {"daq/files.py", "daq/runs/mcap_run.py", "experiments/doctor/preflight.py", "experiments/live/jobs.py",
           "experiments/bounded_child.py", "experiments/simulators/mujoco_runs.py"}
"""Who opens files for writing: the one function, the recorder, the doctor's scratch file, a pseudo-terminal, the pipe
of a child, and an export in a folder that goes again."""


@pytest.mark.parametrize("content", RUNS.values(), ids=RUNS)
def test_no_run_is_replaced_not_even_by_force(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run"
    path.write_bytes(content)
    with pytest.raises(InputError, match="a run is never overwritten"), replacing_anything():
        write_file(path, OURS)
    assert path.read_bytes() == content and [*tmp_path.iterdir()] == [path]


def test_another_kind_needs_force_and_the_same_kind_does_not(tmp_path: Path) -> None:
    path = tmp_path / "notes.json"
    for content in (b"my notes\n", b'{"schema": "legid.model/1"}', DEMO_RIG.read_bytes()):
        path.write_bytes(content)
        with pytest.raises(InputError, match="--force"):
            write_file(path, OURS)
        assert path.read_bytes() == content
    with replacing_anything():
        write_file(path, OURS)
    write_file(path, OURS.replace(b"leg2", b"joint1"))
    assert b"joint1" in path.read_bytes()
    path.write_bytes(b"")  # nothing is in it
    write_file(path, OURS)


def test_what_is_no_run_is_not_taken_for_one() -> None:
    assert kind_of_bytes(b"time_s,tau2_cmd_nm\n0.0,0.1\n") == "plan"
    assert kind_of_bytes(DEMO_RIG.read_bytes()) == "rig"
    for text in (b"a,b\n", b"key = 1.5\nother = 2\n", b"just words\nand, more\n"):
        assert kind_of_bytes(text) == ""


def test_mode_and_links_stay(tmp_path: Path) -> None:
    path, link = tmp_path / "fit.json", tmp_path / "link.json"
    write_file(path, OURS)
    assert stat.S_IMODE(path.stat().st_mode) & 0o600 == 0o600
    path.chmod(0o640)
    link.symlink_to(path)
    write_file(link, OURS.replace(b"leg2", b"joint1"))
    assert link.is_symlink() and b"joint1" in path.read_bytes() and stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_pipe_is_written_into() -> None:
    read, write = os.pipe()
    write_file(f"/dev/fd/{write}", OURS)
    os.close(write)
    assert os.read(read, 1000) == OURS
    os.close(read)


def test_a_folder_and_a_place_that_is_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        write_file(tmp_path, OURS)
    with pytest.raises(InputError, match="give a place that can be written"):
        write_file(tmp_path / "no" / "where.json", OURS)


@pytest.mark.parametrize("command, status", [
    ("calibrate shunt still.mcap --rig rig.toml", 2), ("init new.toml --defaults", 2),
    ("recover still.mcap", 2), ("record --emulate --rig rig.toml --plan plan.csv --out new.mcap", 1),
    ("export still.mcap --out still.csv", 2),
    ("excite --rig rig.toml --peak 0.5 --seconds 5 --out plan.csv", 2), ("runs . --json runs.json", 2)])
def test_a_full_disk_leaves_what_is_there_whole_and_no_half_a_file(command: str, status: int, tmp_path: Path) -> None:
    """As full as a limit of 100 bytes on every file makes it; the commands run in a process of their own."""
    from tests.support.motor_off_runs import write_off

    (tmp_path / "rig.toml").write_bytes(DEMO_RIG.read_bytes())
    (tmp_path / "plan.csv").write_text("time_s,tau2_cmd_nm\n0.0,0.1\n0.5,0.1\n")
    write_off(tmp_path / "still.mcap")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    done = subprocess.run([sys.executable, "-m", "legid.cli", *command.split()], cwd=tmp_path, text=True,
                          check=False, capture_output=True,
                          env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"},
                          preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))
    said = done.stderr.splitlines()[-1]
    assert done.returncode == status and "too large" in said and "internal error" not in said
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("links", [True, False])
def test_a_copied_run_comes_whole_or_not_at_all(links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    if not links:  # as on a memory card's file system
        monkeypatch.setattr(os, "link", refused)
    path = tmp_path / "r.mcap"
    with new_run(path) as file:
        file.write(b"whole")
        assert not path.exists()
    assert path.read_bytes() == b"whole"
    with pytest.raises(InputError, match="never overwritten"), new_run(path):
        pass
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(InputError, match=r"No space left on device; free space there"), new_run(tmp_path / "n") as file:
        file.write(b"half")
        raise full
    with pytest.raises(InputError, match="never overwritten"), new_run(tmp_path / "late") as file:
        file.write(b"ours")
        (tmp_path / "late").write_bytes(b"theirs")  # came while ours was being copied
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"r.mcap": b"whole", "late": b"theirs"}


def test_all_writing_goes_through_the_one_function() -> None:
    writes = re.compile(r"""\.write_(bytes|text)\(|open\([^()]*(\([^()]*\)[^()]*)*["'][rbt]*[wxa+][bt+]*["']""")
    found = {str(p.relative_to(ROOT)) for floor in ("daq", "drivers", "estimator", "experiments")
             for p in (ROOT / floor).rglob("*.py") if writes.search(p.read_text())}
    assert found == WRITERS
