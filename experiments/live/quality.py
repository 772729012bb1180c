"""Is a recorded run sound? Asked of `legid runs` in a process of its own, so that the dashboard never waits."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import msgspec
from msgspec import Struct

from experiments.live import children


class Quality(NamedTuple):
    """Quality of one run."""

    sound: bool
    words: str
    """What it has lost, or how well its clock is known."""


class _Line(Struct):
    flaws: list[str]
    seconds: float = 0.0
    clock_bound_s: float | None = None


class _Document(Struct):
    runs: list[_Line]


async def look_at(path: Path) -> Quality:
    """Quality by `legid runs`; an unreadable run is not sound."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "runs.json"
        child = await children.start(["runs", str(path), "--json", str(out), "--quiet"], nice=True)
        try:
            _, said = await child.communicate()
        except asyncio.CancelledError:  # a recording begins: it has the machine to itself
            with suppress(ProcessLookupError):
                child.kill()
            raise
        try:
            (line,) = msgspec.json.decode(out.read_bytes(), type=_Document).runs
        except (OSError, ValueError, msgspec.MsgspecError):
            why = said.decode(errors="replace").strip().splitlines()[-1:] or ["its command ended without a word"]
            return Quality(False, f"could not be read: {why[0]}")
    if line.flaws:
        return Quality(False, "; ".join(line.flaws))
    clock = "" if line.clock_bound_s is None else f", clock to {line.clock_bound_s * 1e6:.0f} µs"
    return Quality(True, f"{line.seconds:.0f} s, no gap, no drop, no clipping{clock}")
