"""`Bench`: what all open pages share: the session, the plans, the runs and the jobs on them."""

from __future__ import annotations

import asyncio
import stat
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq import InputError, RigFile
from daq.recording import read_plan
from experiments.live.jobs import Job, Kind, past_jobs
from experiments.live.quality import Quality, look_at
from experiments.live.session import Session

JOBS_KEPT = 20
RUNS_SHOWN = 40


@dataclass(frozen=True)
class PlanChoice:
    """A torque plan that can be started."""

    path: Path
    seconds: float
    peak_nm: float

    @property
    def label(self) -> str:
        return f"{self.path.name}: {self.seconds:.0f} s, up to {self.peak_nm:.2f} N m"


class Bench:
    """One rig, one folder of plans, one of runs."""

    def __init__(self, file: RigFile, plans: Path, out: Path) -> None:
        self.path, self.rig, self.out = file.path, file.rig, out
        self._sha256 = file.sha256
        self.session = Session(file.path, out, file.sha256)
        self.jobs: list[Job] = past_jobs(file.path, out)[:JOBS_KEPT]
        self.quality: dict[Path, Quality] = {}
        """What is known of runs by now; `look_at_runs` finds out."""
        self._looking: asyncio.Task[None] | None = None
        self._plans_folder = plans
        self._plans = self._scan()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def plans(self) -> list[PlanChoice]:
        """Every CSV file of the folder that is a plan, as of the last look."""
        return self._plans

    async def look_for_plans(self) -> None:
        """Look for plans again, off the event loop, which an emergency stop needs; not during a recording."""
        if not self.session.running:
            self._plans = await asyncio.to_thread(self._scan)

    def _scan(self) -> list[PlanChoice]:
        choices = []
        named = (path for path in self._plans_folder.glob("*.csv") if _is_text(path.name))
        for path in sorted(named, key=lambda p: (len(p.name), p.name)):
            try:
                plan = read_plan(path)
            except (InputError, ValueError, OSError):
                continue
            choices.append(PlanChoice(path, plan.duration_s, plan.peak_nm))
        return choices

    def runs(self) -> list[Path]:
        """Recorded runs, newest first; what is no file, or goes while it is looked at, is none."""
        found = []
        for path in self.out.glob("*.mcap"):
            with suppress(OSError):
                status = path.stat()
                if stat.S_ISREG(status.st_mode) and _is_text(path.name):
                    found.append((status.st_mtime, path))
        return [path for _, path in sorted(found, reverse=True)[:RUNS_SHOWN]]

    def look_at_runs(self) -> None:
        """Have every run looked at that was not yet: one after the other, each by a process behind everything else."""
        if self._looking is not None or self.session.running:
            return
        fresh = [path for path in self.runs() if path not in self.quality]
        if fresh:
            self._looking = self._keep(self._look(fresh))

    def stop_looking(self) -> None:
        """Stop reading runs before a recording, which needs the whole machine. The rest is read later."""
        if self._looking is not None:
            self._looking.cancel()
            self._looking = None

    async def _look(self, paths: Sequence[Path]) -> None:
        try:
            for path in paths:
                if self.session.running:
                    return
                try:
                    self.quality[path] = await look_at(path)
                except OSError as error:
                    self.quality[path] = Quality(False, f"could not be looked at: {error}")
        finally:
            if self._looking is asyncio.current_task():
                self._looking = None

    def _keep(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    @property
    def busy(self) -> Job | None:
        """The job that is running."""
        return next((job for job in self.jobs if job.state == "running"), None)

    def why_not(self) -> str:
        """Why no job may start now; empty when one may."""
        if self.session.running:
            return "a recording is running"
        if self.busy is not None:
            return f"{self.busy.name.lower()} is running"
        return ""

    def why_not_record(self) -> str:
        """Why no recording may start now; empty when one may. A fit continues meanwhile at lower priority."""
        if self.session.latched:
            return "the emergency stop is pressed"
        if self.session.running:
            return "a recording is running"
        return "a check has the devices open" if self.busy is not None and self.busy.on_devices else ""

    def start_job(self, kind: Kind, runs: Sequence[Path]) -> None:
        """Start a job unless something else is on."""
        if self.why_not():
            return
        job = Job(kind, self.path, runs, self.out, self._sha256)
        self.jobs = [job, *self.jobs][:JOBS_KEPT]
        self._keep(job.run())

    def report(self, name: str) -> Path | None:
        """A report page of the runs' folder by its file name; a link is none: it may lead out of the folder."""
        path = self.out / name
        with suppress(OSError, ValueError):
            if path.parent == self.out and path.suffix == ".html" and stat.S_ISREG(path.lstat().st_mode):
                return path
        return None

    async def close(self) -> None:
        """Stop the recorder, end the job."""
        self.stop_looking()
        if self.busy is not None:
            self.busy.cancel()
        await self.session.close()


def _is_text(name: str) -> bool:
    """The name can be sent to a browser."""
    return name.isprintable()
