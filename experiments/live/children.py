"""`legid` commands as processes of their own, which share nothing with the dashboard but files and pipes."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from estimator import SAFE_PATH

ROOT = Path(__file__).parents[2]
NICE = 5


def command(arguments: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """(arguments, environment) of `legid ARGUMENTS` as a process: it imports nothing from the folder it is started
    in, which may be anybody's."""
    path = os.pathsep.join([str(ROOT), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))])
    return ([sys.executable, "-P", "-m", "legid.cli", *arguments],
            os.environ | SAFE_PATH | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"})


async def start(arguments: Sequence[str], *, pass_fds: Sequence[int] = (), stderr: int | IO[bytes] | None = None,
                stdout: int | IO[bytes] | None = asyncio.subprocess.DEVNULL,
                nice: bool = False) -> asyncio.subprocess.Process:
    """Start `legid ARGUMENTS` in a session of its own: the terminal's Ctrl-C is the dashboard's alone.

    `nice` puts it behind everything else on the machine, a recorder above all.
    """
    words, environment = command(arguments)
    child = await asyncio.create_subprocess_exec(
        *words, stdin=asyncio.subprocess.DEVNULL, stdout=stdout, env=environment,
        stderr=asyncio.subprocess.PIPE if stderr is None else stderr, pass_fds=pass_fds, start_new_session=True)
    if nice:
        os.setpriority(os.PRIO_PROCESS, child.pid, NICE)
    return child
