"""`Job`: a fit, a diagnosis or a check of the devices as a process of its own, with its progress and its verdict."""

from __future__ import annotations

import asyncio
import os
import re
import termios
import time
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from daq import InputError, read_bytes
from experiments.live import children

Kind = Literal["fit", "diagnose", "doctor", "clear"]
_BAR = re.compile(r"^(?P<what>.*?)\s+(?P<percent>\d{1,3})%\|")
"""What tqdm draws: the stage, the share done."""


class Job:
    """One command. `progress` and `verdict` are for a person; `report` is the page it wrote."""

    def __init__(self, kind: Kind, rig: Path, runs: Sequence[Path], out: Path, rig_sha256: str = "") -> None:
        self.kind, self.runs = kind, list(runs)
        self.state: Literal["running", "done", "failed"] = "running"
        self.progress = "starting"
        self.fraction: float | None = None
        """Share done; None where nobody can tell."""
        self.verdict = ""
        self.report: Path | None = None
        self.lines: list[str] = []
        """What the command printed."""
        self._began_s = time.monotonic()
        self._took_s: float | None = None
        self.when = ""
        """Of a job of an earlier session: when it was done."""
        self._json: Path | None = None
        self._child: asyncio.subprocess.Process | None = None
        stem = out / f"{'diagnosis' if kind == 'diagnose' else kind}-{datetime.now():%Y%m%d-%H%M%S}"
        if self.on_devices:
            self._arguments = ["doctor", "--rig", str(rig), "--rig-sha256", rig_sha256, "--out", str(out)]
            self._arguments += ["--clear-faults"] if kind == "clear" else []
        else:
            self._arguments = [kind, *map(str, runs), "--rig", str(rig)]
            self._json, self._page = stem.with_suffix(".json"), stem.with_suffix(".html")
            self._arguments += ["--json", str(self._json), "--html", str(self._page),
                                "--model-out", f"{stem}-model.json"]

    @property
    def name(self) -> str:
        """For a person."""
        return {"fit": "Fit", "diagnose": "Diagnosis", "doctor": "Check of the devices",
                "clear": "Clearing of faults"}[self.kind]

    @property
    def on_devices(self) -> bool:
        """It opens the devices: no recording can, meanwhile."""
        return self.kind in ("doctor", "clear")

    @property
    def seconds(self) -> float:
        """Running time of the job [s]."""
        return (time.monotonic() - self._began_s) if self._took_s is None else self._took_s

    async def run(self) -> None:
        """Run to its end; one that cannot even be started has failed, and says why."""
        try:
            code, output, said = await self._command()
            self.lines = output.strip().splitlines()
            self.verdict = self._judge(code, said)
            if self._json is not None and self._page.exists():
                self.report = self._page
        except Exception as error:
            code, self.verdict = 1, f"could not be run: {error}"
        self._took_s = time.monotonic() - self._began_s
        self.state = "done" if code == 0 else "failed"

    async def _command(self) -> tuple[int, str, str]:
        """(exit status, standard output, last words). The progress bar is drawn on a pseudo-terminal and read from
        there."""
        near, far = os.openpty()
        try:
            termios.tcsetwinsize(far, (24, 100))
            with open(far, "wb", buffering=0) as terminal:
                self._child = await children.start(self._arguments, stdout=asyncio.subprocess.PIPE, stderr=terminal,
                                                   nice=not self.on_devices)
            os.set_blocking(near, False)
            loop, said = asyncio.get_running_loop(), Tail()
            loop.add_reader(near, self._read, near, said, loop)
            assert self._child.stdout is not None
            output = (await self._child.stdout.read()).decode(errors="replace")
            code = await self._child.wait()
            loop.remove_reader(near)
            self._read(near, said, None)
        finally:
            os.close(near)
        return code, output, said.line

    def cancel(self) -> None:
        """End it early."""
        if self._child is not None and self._child.returncode is None:
            with suppress(ProcessLookupError):
                self._child.terminate()

    def _read(self, near: int, said: Tail, loop: asyncio.AbstractEventLoop | None) -> None:
        try:
            data = os.read(near, 65536)
        except BlockingIOError:
            return
        except OSError:  # nobody has the terminal open any more
            if loop is not None:
                loop.remove_reader(near)
            return
        for piece in said.feed(data.decode(errors="replace")):
            if bar := _BAR.match(piece):
                self.progress, self.fraction = bar["what"].strip(" :"), int(bar["percent"]) / 100
            elif " ... " in piece:
                self.progress = piece.partition(" ... ")[0]

    def _judge(self, code: int, said: str) -> str:
        if code < 0:
            return "Ended early."
        document: dict[str, Any] = {}
        if self._json is not None:
            with suppress(OSError, msgspec.DecodeError):
                document = msgspec.json.decode(self._json.read_bytes())
        if self.on_devices:
            return self.lines[-1] if code == 0 and self.lines else said
        if self.kind == "diagnose" and "verdict" in document:
            return f"{document['verdict']}: {document['sentence']}"
        if self.kind == "fit" and document.get("converged"):
            return str(document.get("trust", {}).get("sentence", "The fit converged."))
        return said or f"ended with status {code}"


    @classmethod
    def past(cls, kind: Kind, rig: Path, json: Path, runs: Sequence[Path]) -> Job:
        """One that an earlier session left behind, by its document."""
        job = cls(kind, rig, runs, json.parent)
        job._json, job._page = json, json.with_suffix(".html")
        job.verdict = job._judge(0, "did not converge" if kind == "fit" else "no diagnosis")
        job.state = "failed" if job.verdict in ("did not converge", "no diagnosis") else "done"
        job._took_s = 0.0
        job.when = f"{datetime.fromtimestamp(json.stat().st_mtime):%Y-%m-%d %H:%M}"
        job.report = job._page if job._page.exists() else None
        return job


class _Named(msgspec.Struct):
    """What is read of a document besides its verdict: the runs behind it."""

    file: str


class _Origin(msgspec.Struct):
    runs: list[_Named] = []


class _Past(msgspec.Struct):
    schema: str
    provenance: _Origin = msgspec.field(default_factory=_Origin)


def past_jobs(rig: Path, out: Path) -> list[Job]:
    """Fits and diagnoses of earlier sessions in `out`, newest first, with their verdicts; other files are left."""
    found: list[tuple[float, Job]] = []
    kinds: tuple[tuple[Kind, str, str], ...] = (("fit", "fit", "legid.fit/1"),
                                                ("diagnose", "diagnosis", "legid.diagnosis/1"))
    for kind, stem, schema in kinds:
        for path in out.glob(f"{stem}-*.json"):
            with suppress(OSError, ValueError, KeyError, TypeError, RecursionError, msgspec.MsgspecError, InputError):
                document = msgspec.json.decode(read_bytes(path), type=_Past)
                if document.schema == schema:
                    runs = [out / source.file for source in document.provenance.runs]
                    found.append((path.stat().st_mtime, Job.past(kind, rig, path, runs)))
    return [job for _, job in sorted(found, key=lambda entry: entry[0], reverse=True)]


class Tail:
    """Terminal output as it comes, cut where a line begins anew; `line` is the last that is no progress bar."""

    def __init__(self) -> None:
        self.line = ""
        self._rest = ""

    def feed(self, text: str) -> list[str]:
        """Pieces that are there now, the unfinished one too: tqdm ends its lines when it draws the next."""
        *whole, self._rest = re.split(r"[\r\n]|\x1b\[[0-9;]*[A-Za-z]", self._rest + text)
        pieces = [piece.strip() for piece in [*whole, self._rest] if piece.strip()]
        for piece in pieces:
            if not _BAR.match(piece) and " ... " not in piece:
                self.line = piece
        return pieces
