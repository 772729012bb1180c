"""A command of legid with what it needs: time of a processor and memory, its children included."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.support.paths import ROOT

MOST_S = 90.0
WATCH = f"""
import json, resource, subprocess, sys
try:
    status = subprocess.call(sys.argv[2:], stdin=subprocess.DEVNULL, timeout={MOST_S:g})
except subprocess.TimeoutExpired:
    status = -9
used = resource.getrusage(resource.RUSAGE_CHILDREN)
open(sys.argv[1], "w").write(json.dumps([status, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3]))
"""
"""A process between: the largest memory that the system counts for a child begins with that of the process that
started it, and a process of tests is large."""


class Measured(NamedTuple):
    """What a command did."""

    status: int
    out: str
    error: str
    seconds: float
    """Of a processor"""
    megabytes: float
    """Of its largest process"""


def measured(words: Sequence[str], folder: Path) -> Measured:
    """`legid WORDS` in `folder`, ended after MOST_S."""
    told = folder / "used.json"
    done = subprocess.run([sys.executable, "-c", WATCH, str(told), sys.executable, "-P", "-m", "legid.cli",
                           *words], cwd=folder, capture_output=True, text=True, errors="replace", check=False,
                          env=os.environ | {"PYTHONPATH": str(ROOT)})
    status, seconds, megabytes = json.loads(told.read_text())
    told.unlink()
    return Measured(status, done.stdout, done.stderr, seconds, megabytes)
