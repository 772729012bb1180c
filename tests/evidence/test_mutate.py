"""A short run of the study of broken files."""

import subprocess
import sys

import pytest

from tests.support.paths import ROOT

pytestmark = pytest.mark.slow


def test_broken_files_are_read_or_refused_within_their_bounds() -> None:
    done = subprocess.run([sys.executable, "-m", "tests.evidence", "mutate", "--files", "60", "--chunk", "60"],
                          cwd=ROOT, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("60 files") == 18 and done.stdout.count(" 0 faults") == 18
