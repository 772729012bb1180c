"""`legid calibrate` and `legid tune --write` on a disk without a byte of room, and on the same disk with room again."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.motor_off_runs import RIG, write_off
from tests.support.paths import ROOT
from tests.support.prescribed import ARM_RIG, arm_run, written

SCRIPT = """
import hashlib, json, os, pathlib, shutil, subprocess, sys
files, disk, command = sys.argv[1], pathlib.Path(sys.argv[2]), json.loads(sys.argv[3])
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", disk], check=True)
shutil.copy(pathlib.Path(files, "rig.toml"), disk)
filler = os.open(disk / "filler", os.O_WRONLY | os.O_CREAT)
for size in (4096, 1):
    try:
        while os.write(filler, bytes(size)):
            pass
    except OSError:
        pass
def tried():
    legid = [sys.executable, "-m", "legid.cli", *command]
    done = subprocess.run(legid, cwd=files, text=True, capture_output=True)
    names = sorted(path.name for path in disk.iterdir() if path.name != "filler")
    return done.returncode, done.stderr, names, hashlib.sha256((disk / "rig.toml").read_bytes()).hexdigest()
full = tried()
os.close(filler)
(disk / "filler").unlink()
print(json.dumps([full, tried(), (disk / "rig.toml").read_text()]))
"""
"""In a mount namespace of its own, which takes the disk away when it ends."""

CAN = shutil.which("unshare") is not None and subprocess.run(
    ["unshare", "--mount", "--map-root-user", "sh", "-c", "mount -t tmpfs tmpfs /mnt"], capture_output=True,
    check=False).returncode == 0


@pytest.mark.skipif(not CAN, reason="this machine lets nobody mount a disk of his own (unshare --mount)")
@pytest.mark.parametrize("command, writes", [
    (["calibrate", "shunt", "still.mcap", "--rig", "DISK/rig.toml"], "shunt_offset_a"),
    (["tune", "RUNS", "--rig", "DISK/rig.toml", "--write"], "[terms]")])
def test_the_rig_file_stays_as_it_was_and_is_written_when_there_is_room(command: list[str], writes: str,
                                                                       tmp_path: Path) -> None:
    files, disk = tmp_path / "files", tmp_path / "disk"
    files.mkdir()
    disk.mkdir()
    if command[0] == "tune":
        runs = written([arm_run(k, seconds=4.0, offset=(0.15, 0.0)) for k in range(2)], files)
        command = [part for word in command for part in (runs if word == "RUNS" else [word])]
        stated = "[noise]\nencoder_rad = 1e-4\n[filter]\ncutoff_hz = 8.0\n[sampling]\nrate_hz = 100.0\n"
        (files / "rig.toml").write_text(f"# our arm\n{ARM_RIG}{stated}")
    else:
        write_off(files / "still.mcap")
        (files / "rig.toml").write_text(RIG)
    before = hashlib.sha256((files / "rig.toml").read_bytes()).hexdigest()
    done = subprocess.run(
        ["unshare", "--mount", "--map-root-user", sys.executable, "-c", SCRIPT, str(files), str(disk),
         json.dumps([word.replace("DISK", str(disk)) for word in command])],
        text=True, capture_output=True, check=False, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    full, roomy, text = json.loads(done.stdout)
    status, said, names, left = full
    assert status == 2 and "rig.toml: No space left on device; free space there" in said.splitlines()[-1], said
    assert names == ["rig.toml"] and left == before  # whole as it was, and no half of another beside it
    assert roomy[0] == 0 and roomy[2] == ["rig.toml"] and writes in text, roomy[1]
