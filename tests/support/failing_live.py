"""`legid live` of which one part fails at a time, by the word in the file that LEGID_FAILING names.

    LEGID_FAILING=FILE python -m tests.support.failing_live live --rig ...
"""

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec import ValidationError

from experiments.live import bench, children, page, session
from legid.cli import main

ENTRY = "LEGID_FAILING"
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
GONE = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "run-0.mcap")
PARTS = {
    "runs: file vanished": (bench.Bench, "runs", GONE),
    "runs: disk error": (bench.Bench, "runs", OSError(errno.EIO, os.strerror(errno.EIO))),
    "quality: disk full": (bench, "look_at", FULL),
    "quality: no process": (children, "start", BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))),
    "look at runs": (bench.Bench, "look_at_runs", PermissionError(errno.EACCES, os.strerror(errno.EACCES))),
    "readings": (page, "readings", ValueError("cannot convert float NaN to integer")),
    "list of jobs": (page.Page, "_draw_jobs", RuntimeError("the element is gone")),
    "list of runs": (page.Page, "_draw_runs", UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed")),
    "buttons": (page.Page, "_enable_buttons", AttributeError("no button")),
    "why not": (bench.Bench, "why_not", KeyError("job")),
    "devices card": (page.Page, "_devices", MemoryError("no memory")),
    "limits card": (page.Page, "_limits", TypeError("unsupported format string")),
    "next plan": (page.Page, "_next_plan", IndexError("no plan")),
    "report": (bench.Bench, "report", OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))),
    "packet of the recorder": (session.Session, "_hear", ValidationError("not a status")),
}
"""What fails -> where, which function, how."""


def failing(name: str, whole: Callable[..., Any], error: Exception) -> Callable[..., Any]:
    """`whole`, which raises `error` while the file says `name`."""
    def call(*args: Any, **kwargs: Any) -> Any:
        if Path(os.environ[ENTRY]).read_text() == name:
            raise error
        return whole(*args, **kwargs)
    call.__name__ = whole.__name__
    return call


if __name__ == "__main__":
    for part, (owner, function, error) in PARTS.items():
        setattr(owner, function, failing(part, getattr(owner, function), error))
    sys.exit(main(sys.argv[1:]))
