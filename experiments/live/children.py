"""`legid` commands as processes of their own, which share nothing with the dashboard but files and pipes."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO

ROOT = Path(__file__).parents[2]
NICE = 5


async def start(arguments: Sequence[str], *, pass_fds: Sequence[int] = (), stderr: int | IO[bytes] | None = None,
                stdout: int | IO[bytes] | None = asyncio.subprocess.DEVNULL,
                nice: bool = False) -> asyncio.subprocess.Process:
    """Start `legid ARGUMENTS` in a session of its own: the terminal's Ctrl-C is the dashboard's alone.

    `nice` puts it behind everything else on the machine, a recorder above all.
    """
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "experiments.cli", *arguments, stdin=asyncio.subprocess.DEVNULL, stdout=stdout,
        stderr=asyncio.subprocess.PIPE if stderr is None else stderr, pass_fds=pass_fds, start_new_session=True,
        env=os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"})
    if nice:
        os.setpriority(os.PRIO_PROCESS, child.pid, NICE)
    return child
