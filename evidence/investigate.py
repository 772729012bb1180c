"""`make investigate`: does `legid investigate` find the hidden cause of emulated rigs that nobody has seen?

Each rig is an emulated leg with random parameters and one of the emulator's hidden effects, or none. The effect has the
size that raises the free-run error of the nominal model by a random ratio between 1.3 and 4. `legid investigate` runs
on it without a person. The same rig records a fixed session of eight runs, which is diagnosed too. Called again it
goes on where it stopped.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

import legid
from daq import Rig, WorkError
from daq.runs import read_run
from estimator import FitError
from evidence.blind.score import Rate
from evidence.emulated_legs import RATE_HZ, SPREAD, causes_of, label, leg_of, rig_in
from evidence.kept import kept
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from experiments.emulation import EFFECTS, NOTHING, Hidden, LegBody, record_emulated
from experiments.emulation.plant import HiddenTorque, Motion
from experiments.excite import random_multisine
from experiments.session import prepare
from experiments.workflows import diagnose_prepared
from studies import machine

SEED, BUDGET_MIN = 4040, 30.0
"""Of the study, and the wall time that an investigation may take on a core that others share."""
RUNS, SECONDS, PEAK_NM, OVERHEAD_S = 8, 10.0, 0.7, 5.0
"""The fixed session, as `legid demo` records it, and the time to open the devices for one run."""
RATIOS, CLOSE, TRIES = (1.3, 4.0), 0.05, 5
"""Range of the ratio, how near the size comes to it, and sizes that are tried for it."""
HEALTHY = 2
"""Of ten rigs so many hide nothing."""
GIVEN = 0.85


class Answer(NamedTuple):
    """What one way to record ends with."""

    verdict: str
    causes: tuple[str, ...]
    runs: int
    motion_s: float
    work_s: float
    """Time of the processor for designs, fits and diagnoses, without the emulation [s]."""
    trips: int = 0
    """Runs that a limit ended."""
    ending: str = ""

    @property
    def minutes(self) -> float:
        """The time that it takes at a real rig: motion, opening of the devices, computation."""
        return (self.motion_s + OVERHEAD_S * self.runs + self.work_s) / 60.0


class Outcome(NamedTuple):
    """One rig."""

    truth: str
    """`effect@joint`, empty for a rig that hides nothing."""
    ratio: float
    """Reached by the size: free-run error with the effect over that without."""
    factor: float
    """The size in units of the emulator's own."""
    investigation: Answer
    session: Answer


def scaled(hidden: Hidden, factor: float) -> Hidden:
    """The effect with `factor` times its size."""
    def times(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
        return tuple(factor * one for one in value) if isinstance(value, tuple) else factor * value

    def torque(own: HiddenTorque) -> HiddenTorque:
        def larger(time_s: float, motion: Motion, applied: float) -> tuple[float, float]:
            hip, knee = own(time_s, motion, applied)
            return factor * hip, factor * knee
        return larger

    return replace(hidden, body=tuple((name, value if name == "stribeck_radps" else times(value))
                                      for name, value in hidden.body),
                   torques=tuple(map(torque, hidden.torques)), torque_offset_nm=factor * hidden.torque_offset_nm,
                   gyro_bias_radps=factor * hidden.gyro_bias_radps, imu_late_s=factor * hidden.imu_late_s)


def in_leg(body: LegBody, hidden: Hidden) -> Hidden:
    """The effect together with the parameters of the leg, as one thing to hide in the emulated leg."""
    own = {one.name: getattr(body, one.name) for one in fields(body)} | dict(hidden.body)
    return replace(hidden, body=tuple(own.items()))


def hidden_of(number: int) -> tuple[Hidden, float]:
    """What rig `number` hides and the ratio wanted; every ten rigs hold each effect once."""
    block, place = divmod(number, len(EFFECTS) + HEALTHY)
    order = np.random.default_rng([SEED, block, 1]).permutation(len(EFFECTS) + HEALTHY)
    one = [*EFFECTS.values(), *[NOTHING] * HEALTHY][order[place]]
    low, high = np.log(RATIOS)
    return one, float(np.exp(np.random.default_rng([SEED, number, 2]).uniform(low, high)))


def recorded(folder: Path, rig: Rig, text: str, number: int, hidden: Hidden, which: Sequence[int]) -> list[Path]:
    """Runs of the fixed session, by their numbers."""
    files = [folder / f"session{k}.mcap" for k in which]
    for k, file in zip(which, files):
        file.unlink(missing_ok=True)
        seed = 1000 * number + k
        record_emulated(file, rig, text, random_multisine(seed, SECONDS, PEAK_NM), seed, hidden=hidden)
    return files


def errors(files: Sequence[Path]) -> dict[str, float]:
    """Sensor -> rms free-run error of the last run, by the nominal model of the runs before it."""
    runs = legid.load(files)
    fitted = legid.fit(runs[:-1])
    found = legid.validate(legid.model(fitted), runs[-1:])
    return {name: float(np.sqrt(np.mean([one.rmse[name] ** 2 for one in found]))) for name in found[0].rmse}


def size_for(folder: Path, rig: Rig, text: str, number: int, body: LegBody, hidden: Hidden, wanted: float
             ) -> tuple[float, float]:
    """Factor of the effect's size, and the ratio of the free-run errors that it reaches; all sensors together.

    A secant of the squared ratio, which grows with the square of a small size.
    """
    which = (0, 1, 2)
    plain = errors(recorded(folder, rig, text, number, in_leg(body, NOTHING), which))

    def ratio(factor: float) -> float:
        found = errors(recorded(folder, rig, text, number, in_leg(body, scaled(hidden, factor)), which))
        return float(np.sqrt(np.mean([(found[name] / plain[name]) ** 2 for name in plain])))

    tried, factor = [], 1.0
    for _ in range(TRIES):
        try:
            tried.append((factor, ratio(factor)))
        except (FitError, WorkError):  # no nominal model: too large
            factor *= 0.5
            continue
        if abs(np.log(tried[-1][1] / wanted)) < CLOSE:
            break
        excess = max(tried[-1][1] ** 2 - 1.0, 0.02)
        factor *= float(np.clip(np.sqrt((wanted**2 - 1.0) / excess), 0.2, 5.0))
    return min(tried, key=lambda one: abs(np.log(one[1] / wanted)))


def tripped(files: Sequence[Path]) -> int:
    """Runs that a limit ended."""
    return sum(any(note.kind.startswith("limit ") for note in read_run(file).events) for file in files)


@kept
def outcome(number: int) -> Outcome:
    """Rig `number`: its size, its investigation, its fixed session."""
    body, (hidden, wanted) = leg_of(SEED, number), hidden_of(number)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rig, text = rig_in(folder)
        factor, reached = (0.0, 1.0) if hidden is NOTHING else size_for(folder, rig, text, number, body, hidden, wanted)
        own = in_leg(body, scaled(hidden, factor))

        began = time.process_time()
        files = recorded(folder, rig, text, number, own, range(RUNS))
        rate = (time.process_time() - began) / (RUNS * SECONDS)
        began = time.process_time()
        found = diagnose_prepared(prepare(files, rig), workers=1)
        session = Answer(found.verdict, causes_of(found), RUNS, RUNS * SECONDS, time.process_time() - began,
                         tripped(files))

        name = f"rig {number}"
        EFFECTS[name] = own  # under a name that the investigation can ask for
        began = time.process_time()
        try:
            done = legid.investigate(folder / "rig.toml", folder / "out", BUDGET_MIN, name, seed=1000 * number + 500)
        finally:
            del EFFECTS[name]
        work = time.process_time() - began
        causes = () if done.answer is None else tuple(
            dict.fromkeys(label(c.effect, c.joint) for c in done.answer.causes))
        motion = sum(one.seconds for step in done.steps for one in step.experiments)
        files = sorted((folder / "out").glob("run*.mcap"))
        investigation = Answer(done.verdict or "none yet", causes, len(files), motion,
                               max(work - motion * rate, 0.0), tripped(files), done.ending or "")
    return Outcome("" if hidden is NOTHING else label(hidden.effect, hidden.joint), reached, factor, investigation,
                   session)


def alone(truth: str, answer: Answer) -> bool:
    """Whether the answer is the hidden effect and nothing else; for a rig that hides nothing, none."""
    return (answer.verdict, answer.causes) == (("named", (truth,)) if truth else ("none", ()))


def among(truth: str, answer: Answer) -> bool:
    """Whether the hidden effect is named, or one of several."""
    return truth in answer.causes and answer.verdict in ("named", "partial", "one_of")


def wrong(truth: str, answer: Answer) -> bool:
    """Whether it names something that is not hidden."""
    return answer.verdict in ("named", "partial") and not set(answer.causes) <= {truth}


def page(rigs: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows = list[Outcome]()
    for number in within(minutes, range(rigs)):
        rows.append(outcome(number))
        print(number, rows[-1], flush=True)
    sick = [one for one in rows if one.truth]
    well = [one for one in rows if not one.truth]
    strong = [one for one in sick if one.ratio >= (1.0 - CLOSE) * RATIOS[0]]
    ways = (("investigation", [one.investigation for one in rows]), ("eight runs", [one.session for one in rows]))

    def cells(check: Callable[[str, Answer], bool], of: Sequence[Outcome]) -> str:
        return " | ".join(str(Rate(sum(check(one.truth, getattr(one, way)) for one in of), len(of)))
                          for way in ("investigation", "session"))

    trips = [sum(a.trips for a in answers) for _, answers in ways]
    middle = [[float(np.median([getattr(a, what) for a in answers])) for _, answers in ways]
              for what in ("runs", "motion_s", "work_s", "minutes")] if rows else [[np.nan] * 2] * 4
    yield from [
        "# Investigations of rigs that nobody has seen", "",
        f"Made by `make investigate MINUTES={minutes:g}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, {machine()}, "
        "one core that other work shared.", "",
        f"Each rig is an emulated leg through the drivers. Its parameters scatter by {100 * SPREAD:.0f} %. It "
        f"hides one of {len(EFFECTS)} effects of the emulator, or nothing in {HEALTHY} of ten. Its size raises the "
        f"free-run error of the nominal model by a ratio drawn between {RATIOS[0]:g} and {RATIOS[1]:g}. The ratio is "
        "the rms over the sensors, on the third of the eight runs, by the model of the first two.", "",
        f"`legid.investigate` records and diagnoses without a person, in at most {BUDGET_MIN:g} minutes of a shared "
        f"core. The fixed session is {RUNS} runs of {SECONDS:g} s of a random multisine, as `legid demo` records them, "
        f"and one diagnosis. Both sample at {RATE_HZ:g} Hz.", "",
        f"{len(rows)} of {rigs} rigs were measured." if len(rows) < rigs else f"All {rigs} rigs were measured.", "",
        "| | investigation | eight runs | wanted |", "| --- | --- | --- | --- |",
        f"| the hidden effect alone is named | {cells(alone, sick)} | {100 * GIVEN:.0f} % |",
        f"| the same where the ratio was reached | {cells(alone, strong)} | |",
        f"| it is named, or one of several | {cells(among, sick)} | |",
        f"| something else is named | {cells(wrong, rows)} | |",
        f"| nothing hidden: `none` | {cells(alone, well)} | |",
        f"| runs that a limit ended | {trips[0]} | {trips[1]} | 0 |",
        f"| runs, median | {middle[0][0]:g} | {middle[0][1]:g} | |",
        f"| motion, median [s] | {middle[1][0]:.0f} | {middle[1][1]:.0f} | |",
        f"| computation on one core, median [s] | {middle[2][0]:.0f} | {middle[2][1]:.0f} | |",
        f"| minutes at a rig, median | {middle[3][0]:.1f} | {middle[3][1]:.1f} | |", "",
        f"Minutes at a rig are motion, {OVERHEAD_S:g} s to open the devices for each run, and computation. The time of "
        "the emulation is left out.", "",
        "| hidden | ratio | size | investigation | ending | runs | min | eight runs | min |",
        "| --- | ---: | ---: | --- | --- | ---: | ---: | --- | ---: |"]
    for one in rows:
        ends = [f"{a.verdict}{': ' if a.causes else ''}{', '.join(a.causes)}" for a in (one.investigation, one.session)]
        yield (f"| {one.truth or 'nothing'} | {one.ratio:.2f} | {one.factor:.2g} | {ends[0]} | "
               f"{one.investigation.ending} | {one.investigation.runs} | {one.investigation.minutes:.1f} | {ends[1]} | "
               f"{one.session.minutes:.1f} |")
    yield from ["", "The size is in units of the effect of `legid demo`. "
                f"{len(sick) - len(strong)} of {len(sick)} hidden effects stay below the ratio {RATIOS[0]:g}: none of "
                f"{TRIES} sizes that were tried comes nearer to the ratio drawn.", ""]


EVIDENCE = (
    Evidence("Investigations of emulated rigs without a person: is the hidden cause named alone?", "make investigate",
             "investigate.md", 60, "85 %, no limit touched",
             (r"the hidden effect alone is named \| ([^|]*\)) \|", r"(?:runs that a limit ended) \| (\d+) \|")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, rigs=(20, "at most"),
               minutes=(60.0, "after which no other rig is begun"))
