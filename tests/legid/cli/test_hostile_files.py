"""Hostile files through the commands that read them: one line within bounds, and nothing is run or written."""

import resource
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

from daq import parse_rig
from tests.support.hostile_files import ATTACKS, HARMLESS, RUNS
from tests.support.measured_command import measured
from tests.support.paths import CASES, DEMO_RIG
from tests.support.processes import ran

FOLDER = CASES / "hostile"
SECONDS, MEGABYTES = 10.0, 1000.0
SLOW = ("4 GB", "10^9", "40 datasets", "20,000 links", "2 MB")
"""Words of attacks that take some seconds to make or to refuse."""
GIVEN = {"frombuffer.pkl": ("import", "fit"), "stride0.pt": ("import", "fit"), "big.h5": ("import", "fit"),
         "badblock.csv.gz": ("import", "info", "fit"), "garbagechunk.mcap": ("info", "recover", "fit"),
         "unkcomp.mcap": ("info", "recover", "fit"), "v_abs.json": ("verify",), "v_long.json": ("verify",),
         "evil.urdf": ("init",), "started_9x30.mcap": ("info", "runs")}
WORDS = {"import": ("import", "FILE", "--map", "map.toml", "--guess"), "fit": ("fit", "FILE", "--rig", str(DEMO_RIG)),
         "info": ("info", "FILE"), "recover": ("recover", "FILE", "--out", "new.mcap"), "verify": ("verify", "FILE"),
         "init": ("init", "new.toml", "--from", "FILE"), "runs": ("runs", "FILE")}


def harmless(command: Sequence[str], file: str, folder: Path, read: bool) -> None:
    """`legid COMMAND` says one line, or none where the file may be read."""
    status, _, said, seconds, megabytes = measured([file if word == "FILE" else word for word in command], folder)
    assert status in ((0, 1, 2) if read else (1, 2)), said
    assert (len(said.strip().splitlines()) <= 1 and said.startswith("legid ")) or (read and not said), said
    assert "internal error" not in said and "Traceback" not in said
    assert seconds < SECONDS and megabytes < MEGABYTES, f"{seconds:.1f} s, {megabytes:.0f} MB"


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] if any(w in name for w in SLOW) else [])
                                  for name in ATTACKS])
def test_an_attack_ends_in_one_line(name: str, tmp_path: Path) -> None:
    make, command = ATTACKS[name]
    if command[0] == "import":
        pytest.importorskip("h5py" if "HDF5" in name else "numpy")
    file = make(tmp_path)
    before = set(tmp_path.iterdir())
    harmless(command, file, tmp_path, name in HARMLESS or command == RUNS)
    new = {path.name for path in set(tmp_path.iterdir()) - before}
    assert new <= {"said", "new.toml"}
    if "new.toml" in new:
        rig = parse_rig((tmp_path / "new.toml").read_text())
        assert rig.limits.torque_nm == 2.0 and set(tomllib.loads((tmp_path / "new.toml").read_text())) <= {
            "mechanism", "imu", "motor", "sampling", "devices", "limits", "calibration", "prior", "tolerance"}


@pytest.mark.skipif(not FOLDER.is_dir(), reason="the cases are not on this machine")
@pytest.mark.parametrize("name, command", [(name, how) for name, hows in GIVEN.items() for how in hows])
def test_a_file_that_did_harm_does_none(name: str, command: str, tmp_path: Path) -> None:
    read = command in ("info", "recover", "init", "runs")
    harmless(WORDS[command], str(FOLDER / name), tmp_path, read)
    if (tmp_path / "new.toml").exists():  # MuJoCo may refuse the robot
        rig = parse_rig((tmp_path / "new.toml").read_text())
        assert rig.devices.controller is None and rig.noise.encoder_rad is None


@pytest.mark.skipif(not FOLDER.is_dir(), reason="the cases are not on this machine")
def test_a_folder_with_a_broken_number_is_listed(tmp_path: Path) -> None:
    """All files of the folder are in the list, those that cannot be read too."""
    done = ran("-P", "-m", "legid.cli", "runs", FOLDER, cwd=tmp_path)
    assert all(path.name in done.stdout for path in FOLDER.glob("*.mcap")) and done.stderr == ""


def test_the_limits_are_the_child_s_alone(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_AS), resource.getrlimit(resource.RLIMIT_CPU)
    from experiments.exchange import read_imported
    (tmp_path / "a.csv").write_text("t,q\n" + "\n".join(f"{k},{k}" for k in range(100)))
    assert read_imported(tmp_path / "a.csv").names == ["t", "q"]
    assert (resource.getrlimit(resource.RLIMIT_AS), resource.getrlimit(resource.RLIMIT_CPU)) == before
