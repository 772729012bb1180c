"""`python -m evidence machines`: public records of machines that we did not build, through typed commands.

The records are no part of the project. `--snapshots DIR` is a folder with a clone of each repository under its own
name; files are taken from the commit that the page names.
"""

import json
import math
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from evidence.frame import Lines, new_folder, program, table, tell
from evidence.held_uses import Held, on_new_runs
from evidence.kept import kept
from evidence.machine_records import MACHINES, Machine
from evidence.registry import Evidence
from tests.support.paths import ROOT

LONGEST = 170
"""Characters of a message that the page shows."""
LIMIT_S, STOPPED = 600, 124
"""Seconds for one command, and the exit status of one that needs more."""


Row = tuple[str, float, int, str]
"""Command, seconds, exit status, the sentence that answers."""


class Session(NamedTuple):
    """What came of a machine's commands."""

    rows: Sequence[Row]
    parameters: dict[str, tuple[float, float, float]]
    """Name -> value and 95 % interval, of those determined."""
    verdict: str
    """The first line of the fit."""


class FreeRun(NamedTuple):
    """Errors over 1 s of one run, by each set of parameters; or what stopped it."""

    run: str
    ours: tuple[float, ...] = ()
    published: tuple[float, ...] = ()
    message: str = ""
    held: tuple[Held, ...] = ()
    """Uses that the fit to the other runs supports, on this run"""

    @property
    def below(self) -> bool:
        return bool(self.ours) and math.hypot(*self.ours) < math.hypot(*self.published)


def typed(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """The command, with all its processes stopped after `LIMIT_S`."""
    words = [file for word in shlex.split(command)[1:] for file in (
        sorted(str(one.relative_to(folder)) for one in folder.glob(word)) if "*" in word else [word])]
    done = subprocess.run(["/usr/bin/timeout", str(LIMIT_S), sys.executable, "-m", "legid.cli", *words],
                          cwd=folder, capture_output=True, text=True,
                          env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})
    if done.returncode == STOPPED:
        done.stderr += f"legid gave no answer in {LIMIT_S} s\n"
    return done


def unpack(one: Machine, snapshot: Path, folder: Path) -> None:
    """The rig, the map and the records, as a person has them at the start: of `FILE#LIST` the first that is listed."""
    (folder / "rig.toml").write_text(one.rig)
    if one.columns:
        (folder / "columns.toml").write_text(one.columns)
    for name, path in one.files.items():
        path, _, listed = path.partition("#")
        record = shown(snapshot, one.commit, path)
        (folder / name).write_bytes(json.dumps(json.loads(record)[listed][0]).encode() if listed else record)


def shown(snapshot: Path, commit: str, path: str) -> bytes:
    """A file of a commit."""
    return subprocess.run(["git", "-C", str(snapshot), "show", f"{commit}:{path}"], check=True,
                          capture_output=True).stdout


@kept
def session(one: Machine, snapshot: Path) -> Session:
    """Every command of one machine, typed in a new folder."""
    with new_folder() as folder:
        unpack(one, snapshot, folder)
        rows = [timed(command, folder) for command in one.commands]
        if not (folder / "fit.json").exists():
            return Session(rows, {}, "")
        fit = json.loads((folder / "fit.json").read_bytes())
    return Session(rows, {p["name"]: (p["value"], *p["ci95"]) for p in fit["parameters"]
                          if p["value"] is not None and p["ci95"] is not None}, fit["trust"]["sentence"])


def timed(command: str, folder: Path) -> Row:
    began = time.monotonic()
    done = typed(command, folder)
    row = command, time.monotonic() - began, done.returncode, answer(command, done)
    tell(*row)
    return row


def commands_table(rows: Iterable[Row]) -> str:
    return table("command | s | exit | answer", (
        (f"`{command}`", f"{seconds:.0f}", status, said) for command, seconds, status, said in rows))


@kept
def free_runs(one: Machine, snapshot: Path) -> list[FreeRun]:
    """Each run, simulated by what the others determine and by what is published."""
    out = []
    with new_folder() as folder:
        unpack(one, snapshot, folder)
        for command in (*(c for c in one.commands if c.startswith("legid import")), *one.more):
            typed(command, folder)
        for run in one.runs:
            others = " ".join(other for other in one.runs if other != run)
            out.append(left_out(one, folder, run, others))
            tell(out[-1])
    return out


def left_out(one: Machine, folder: Path, run: str, others: str) -> FreeRun:
    """The run by parameters of the others; values that nobody published are equal in both models."""
    for name in ("own.json", "own_fit.json", "published.json", "errors.json"):
        (folder / name).unlink(missing_ok=True)
    fit = f"legid fit {others} --rig rig.toml {one.given}--json own_fit.json --model-out own.json"
    done = typed(fit, folder)
    if not (folder / "own.json").exists():
        return FreeRun(run, message=answer(fit, done))
    uses = json.loads((folder / "own_fit.json").read_bytes())["uses"]
    held = tuple(use for use in on_new_runs("", uses, folder / "own.json", folder / "rig.toml",
                                            [folder / other for other in others.split()], [folder / run])
                 if use.supported)
    model = json.loads((folder / "own.json").read_bytes())
    for p in model["parameters"]:
        p["value"] = {**one.published, **one.implied}.get(p["name"], p["value"])
    (folder / "published.json").write_text(json.dumps(model))
    check = f"legid validate own.json {run} --rig rig.toml --against published.json --horizons 1 --json errors.json"
    done = typed(check, folder)
    if not (folder / "errors.json").exists():
        return FreeRun(run, message=answer(check, done), held=held)
    second = next(h for h in json.loads((folder / "errors.json").read_bytes())["horizons"] if h["horizon_s"] == 1.0)
    ours, theirs = ({name: math.inf if e is None else e for name, e in side["rmse"].items()}
                    for side in (second, second["against"]))
    return FreeRun(run, tuple(ours.values()), tuple(theirs[name] for name in ours), held=held)


def answer(command: str, done: subprocess.CompletedProcess[str]) -> str:
    """The line that a person reads first: the error, else the verdict, else what was written."""
    said = [line for line in done.stdout.splitlines() if line]
    refused = [line for line in done.stderr.splitlines() if line.startswith("legid ")]
    if command.startswith("legid import"):
        written = sum("samples at" in line for line in said)
        line = refused[-1] if refused else f"{written} runs written" if written > 1 else said[-1]
    else:
        line = said[0] if said and done.returncode == 0 else (refused or said)[-1]
    return line if len(line) <= LONGEST else line[:LONGEST].rsplit(" ", 1)[0] + " ..."


def clones(snapshots: str, repositories: Iterable[str]) -> list[Path]:
    """Where the repositories are. Raises SystemExit where one is not."""
    places = [Path(snapshots) / one.split("/")[1] for one in repositories]
    for one, place in zip(repositories, places):
        if not snapshots or not place.is_dir():
            raise SystemExit(f"{place} is not there: give --snapshots FOLDER, and git clone https://github.com/{one}")
    return places


def page(snapshots: str = "") -> Lines:
    places = clones(snapshots, [one.repository for one in MACHINES])
    found = [session(one, place) for one, place in zip(MACHINES, places)]
    free = [free_runs(one, place) for one, place in zip(MACHINES, places)]
    longest = max(sum(row[1] for row in many.rows) for many in found)
    yield from [
        "# Ten machines that we did not build",
        "Public records, from their authors' files to a diagnosis, by at most five commands each. The longest session "
        f"takes {longest / 60:.1f} minutes. Each row has a command, its seconds and exit status, and the first line of "
        "its answer. Numbers 6 to 8 have gears or cables. No setting of legid was changed for them.",
        "The last table of each machine has rms errors of simulations over 1 s. No run helps to identify the "
        "parameters that simulate it. Values that nobody published are equal on both sides. Its last column has "
        "the uses that the fit to the others supports, what this run errs, and whether the interval holds."]
    yield table("machine | repository | commit | licence", (
        f"{number}. {one.title} | [{one.repository}](https://github.com/{one.repository}) | `{one.commit[:10]}` | "
        f"{one.licence}" for number, one in enumerate(MACHINES, 1)))
    for number, (one, many, runs) in enumerate(zip(MACHINES, found, free), 1):
        by_hand = f"\n# columns.toml, by hand\n{one.columns}" * bool(one.columns)
        yield from [f"## {number}. {one.title}", f"```toml\n{one.rig}{by_hand}```"]
        yield commands_table(many.rows)
        yield table(f"parameter | legid, 95 % interval | published: {one.source} | ratio | within three half "
                    "widths | within 6 % or not trusted | within 95 % interval", (
            compared(name, many.parameters.get(name), value, not many.verdict.startswith("TRUST"))
            for name, value in one.published.items()))
        yield table("run | error by the other runs' parameters | by published parameters | less in total | uses of the "
                    "others' fit, and what this run errs", (
            (f"{run.run} | {run.message} | | " if run.message else
             f"{run.run} | {each(run.ours)} | {each(run.published)} | {'yes' if run.below else 'no'}")
            + f" | {'; '.join(map(use_text, run.held)) or 'none'}" for run in runs))
        yield from (f"- {remark}" for remark in one.remarks)


def each(errors: Sequence[float]) -> str:
    """Errors of all coordinates [rad or m]."""
    return ", ".join(f"{e:.3g}" if math.isfinite(e) else "diverges" for e in errors)


def use_text(one: Held) -> str:
    """A supported use, what it states, what the new run errs, and whether its interval has that."""
    return f"{one.what} {100 * one.stated:.2g} %: {100 * one.found:.2g} %, {'held' if one.within else 'missed'}"


def compared(name: str, found: tuple[float, float, float] | None, published: float, flagged: bool) -> str:
    """A row of the table of parameters."""
    if found is None:
        return f"{name} | not determined | {published:.4g} | | no | yes | no"
    value, low, high = found
    shown = f"{value:.4g} ({low:.4g} to {high:.4g})" if high > low else f"{value:.4g}, at its bound"
    ratio = value / published
    near, passed = abs(value - published) <= 1.5 * (high - low), flagged or abs(ratio - 1.0) <= 0.06
    answers = " | ".join("yes" if one else "no" for one in (near, passed, low <= published <= high))
    return f"{name} | {shown} | {published:.4g} | {ratio:.2f} | {answers}"


def result(text: str) -> str:
    """The result for the index: parameters within three half widths, those not trusted, runs, the longest session."""
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    values = [row for row in cells if row[0].startswith("beta")]
    runs = [row for row in cells if len(row) == 5 and row[0].endswith(".csv")]
    uses = [use for row in runs for use in row[4].split("; ") if use != "none"]
    minutes = text.split("The longest session takes ")[1].split(" minutes")[0]
    near, passed, inside = (sum(row[column] == "yes" for row in values) for column in (4, 5, 6))
    return (f"{inside} of {len(values)} published values within their 95 % interval, {near} within three half widths, "
            f"{passed} within 6 % or not trusted; {sum(use.endswith('held') for use in uses)} of {len(uses)} supported "
            "uses hold on a new run; "
            f"{sum(row[3] == 'yes' for row in runs)} of {len(runs)} runs err less than by published parameters; "
            f"the longest session takes {minutes} min")


EVIDENCE = Evidence(
    "Public records of ten machines, from their authors' files to a diagnosis",
    "python -m evidence machines", "machines.md", 20,
    "at most five commands and ten minutes each; each value within 6 % or not trusted", result)
main = program(page)
