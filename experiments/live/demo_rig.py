"""An emulated rig for the dashboard, in a separate process that ends with it."""

from __future__ import annotations

import select
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daq import WorkError
from experiments.emulation import DEFAULT
from experiments.live.children import command

STARTED_S = 30.0


@contextmanager
def started_demo_rig(folder: Path, drive: str = "legid") -> Iterator[Path]:
    """The rig file of an emulated rig with this `drive`, while it is served. Raises `WorkError` where none starts."""
    words, environment = command(["emulate", "--out", str(folder), "--effect", DEFAULT, "--drive", drive,
                                  "--until-eof"])
    child = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
                             env=environment)
    assert child.stdin is not None and child.stdout is not None
    try:
        ready, _, _ = select.select([child.stdout], [], [], STARTED_S)
        if not ready or not child.stdout.readline():
            raise WorkError("the emulated rig did not start; try legid emulate")
        yield folder / "rig.toml"
    finally:
        child.stdin.close()
        try:
            child.wait(5.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
