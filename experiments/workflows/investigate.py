"""`investigate`: record, diagnose, record what separates the rivals, until one cause stands or the time is spent."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from daq import InputError, Rig, WorkError, load_rig
from daq.recording import Plan, write_plan
from daq.runs import read_run
from drivers import DriverError
from estimator import FitError
from estimator.diagnosis import Diagnosis
from estimator.signals import angle_column
from experiments.console import make_directory, write_text
from experiments.documents import DiagnosisDocument, InvestigationDocument
from experiments.excite import (
    Band,
    Bench,
    Candidate,
    Question,
    Search,
    contest_of,
    first_plan,
    next_motion,
    plan_session,
    question_in,
    separate,
    settling_seconds,
    usual_choice,
    widening_bands,
)
from experiments.judge import Ending, Experiment, Investigation, Step, check_sound, diagnosed_model, model_of
from experiments.models import Model, save_model
from experiments.provenance import Origin
from experiments.reports import (
    write_diagnosis,
    write_investigation,
)
from experiments.session import load_runs, prepare, setup_of
from experiments.workflows.diagnose import diagnose_prepared
from experiments.workflows.fit import fit_runs
from experiments.workflows.record import record_plan
from experiments.workflows.time_budget import OVERHEAD_S, RESERVE, Clock, End, Spent

SECONDS = 10.0
"""Length of a usual run [s]; one in another direction of motion has twice as much."""
USUAL = 4
"""Runs of the default design before the first diagnosis: one of each usual kind."""
GENTLE, GROWTH, ROOM = 4, 2.0, 0.5
"""Runs without a model, at most. Each has so many times the torque of the one before, if its motion is expected to keep
this share of every limit."""
KNOWN = 0.1
"""Largest relative standard error of the parameters with which plans are designed."""
MARGIN, SMALLER = 0.8, 0.7
"""Share of each limit that plans use, and its factor after a run that reached a limit."""
TRIPS = 2
"""Runs that reach a limit, after which no other is begun."""
REPEATS = 4
"""Times, at most, that a separating plan is repeated within its run."""
SETTLED_RUNS = 2
"""Separating runs after which the rivals should be told apart, if their expected ratios say so."""


@dataclass(frozen=True)
class Asked:
    """Choices of the caller of an investigation."""

    confirm: Callable[[str], bool]
    """Asked with a description of each recording before it; not for an emulated leg."""
    emulate: str | None = None
    seed: int = 1
    """Of the noise of an emulated leg, and of the plans."""
    workers: int | None = None
    """Processes of a diagnosis, by default one a core."""
    progress: Callable[[str, float], None] = lambda stage, share: None
    told: Callable[[Step], None] = lambda step: None
    """Called with each step when it is done."""


class Investigator:
    """One investigation; all its files are in `out`."""

    def __init__(self, rig_path: Path | str, out: Path, budget_s: float, asked: Asked,
                 origin: Callable[[list[Path]], Origin]) -> None:
        """Raises `InputError` for a rig or a folder that cannot be used, and a budget too small for one diagnosis."""
        self.rig_path, self.out, self.asked, self.origin = rig_path, out, asked, origin
        self.rig: Rig = load_rig(rig_path)
        if out.exists() and any(out.glob("run*.mcap")):
            raise InputError(str(out), "holds runs of an earlier investigation", "give another folder with --out")
        self.clock = Clock(budget_s)
        self.steps: list[Step] = []
        self.files: list[Path] = []
        self.plans: list[Plan] = []
        self.kinds: set[str] = set()
        self.margin, self.trips = MARGIN, 0
        self.model: Model | None = None
        self.settled: dict[frozenset[str], list[float]] = {}
        self._pending: list[Experiment] = []
        self._before_first()
        make_directory(out)
        write_text(out / "rig.toml", Path(rig_path).read_text(encoding="utf-8"))

    def run(self) -> Investigation:
        """All steps. After each the journal is written; Ctrl-C ends the investigation with the journal whole."""
        try:
            self._record_first()
            while True:
                self._follow(self._diagnose())
        except End as end:
            return self._finish(end.ending, end.why)
        except Spent:
            return self._finish("budget", f"The budget of {self.clock.budget_s / 60.0:g} min was spent before the step "
                                          "ended.")
        except KeyboardInterrupt:
            return self._finish("stopped", "Ctrl-C ended the investigation.")
        except (InputError, FitError, WorkError, DriverError) as error:
            if not self.files:
                raise
            return self._finish("failed", f"{error}.")

    # -- the first diagnosis -------------------------------------------------------------------------------

    def _before_first(self) -> None:
        """Raises `InputError` where the budget holds no first diagnosis."""
        runs = USUAL + 2
        needed = self.clock.expected_s(runs * SECONDS, runs, 0.0, True)
        if needed > self.clock.budget_s:
            raise InputError("--budget", f"{self.clock.budget_s / 60.0:g} min hold no first diagnosis, which is "
                                         f"expected after {needed / 60.0:.1f} min", "give more minutes")

    def _record_first(self) -> None:
        """Gentle runs until the parameters are known, then one run of each usual kind."""
        self._record_gentle()
        began = self.clock.spent_s
        with self.clock.limited():
            session = plan_session(self._bench(), Band(SECONDS, 0.0, 3.0), self._search(), usual_choice(), USUAL,
                                   lambda kind, share: self.asked.progress(f"designing {kind}", share))
        self.clock.design_s = RESERVE * (self.clock.spent_s - began)
        self.clock.require(self.clock.expected_s(USUAL * SECONDS, USUAL, self._motion_s, False), "the first diagnosis")
        for plan in session.plans:
            self._record(plan.candidate.plan, plan.kind, "Default design: one run of each usual kind.")

    def _record_gentle(self) -> None:
        """Runs without a model, of growing torque, until a fit of all of them is good enough for a design."""
        peak, why = None, "Nothing is known of the rig: random phases with a tenth of the torque limit."
        for turn in range(GENTLE):
            plan = first_plan(self.rig, self.asked.seed + turn, SECONDS, peak)
            self._record(plan, "first", why)
            with suppress(FitError, InputError, WorkError), self.clock.limited():  # too little motion for a model
                self.asked.progress("fitting", 0.0)
                fitted = fit_runs(self.files, self.rig)
                check_sound(fitted.result, for_model=True)
                made = model_of(fitted.result, fitted.setup.settings, fitted.setup.options.hold,
                                [run.name for run in fitted.setup.datasets])
                made = _positive(made)
                Bench(made, self.rig, "the first fit")
                self.model = made
                if (fitted.result.std < KNOWN * np.abs(fitted.result.beta)).all():
                    return
            factor = min(GROWTH, ROOM / max(self._used(), 1e-9))
            if factor * plan.peak_nm <= plan.peak_nm or self.trips:
                break
            peak = min(factor * plan.peak_nm, self.margin * self.rig.limits.torque_nm)
            why = (f"The parameters are not known to {100 * KNOWN:.0f} %: the same with {peak / plan.peak_nm:.2g} "
                   "times the torque.")
        if self.model is None:
            raise End("failed", "The first runs do not determine the parameters, so no plan can be designed; record "
                                 "by hand, legid record.")

    def _used(self) -> float:
        """Largest share of a limit of angle or speed that the last run reached."""
        setup = setup_of(load_runs(self.files[-1:], self.rig, damaged=True), self.rig)  # usable or not
        limits, n = self.rig.limits, setup.mechanism.n
        data, shares = setup.datasets[0], [0.0]
        for j, (angle, speed) in enumerate(((limits.q1_rad, limits.q1_speed_radps if n > 1 else limits.speed_radps),
                                            (limits.q2_rad, limits.speed_radps))[:n]):
            column = angle_column(setup.mechanism, j)
            if column in data:
                q = data[column]
                shares += [np.nanmax(np.abs(q)) / angle, np.nanmax(np.abs(np.gradient(q, data.time_s))) / speed]
        return float(max(shares))

    # -- one step ------------------------------------------------------------------------------------------

    def _diagnose(self) -> Diagnosis:
        """The ordinary diagnosis of all runs, written with the journal."""
        began = self.clock.spent_s
        with self.clock.limited():
            prepared = prepare(self.files, self.rig)

            def show(stage: str, share: float) -> None:
                if self.clock.spent_s > self.clock.budget_s:
                    raise Spent
                self.asked.progress(f"diagnosing, {stage}", share)

            found = diagnose_prepared(prepared, progress=show, workers=self.asked.workers)
        self.clock.diagnosis = (self.clock.spent_s - began) / self._motion_s
        step = Step(tuple(self._pending), found, self.clock.spent_s)
        self._pending = []
        self.steps.append(step)
        setup, name = prepared.setup, f"diagnosis{len(self.steps)}"
        document = DiagnosisDocument.of(found, prepared.set_aside, setup.datasets, setup.settings.model)
        document.provenance = self.origin(self.files)
        document.to_json(self.out / f"{name}.json")
        write_diagnosis(self.out / f"{name}.html", document, found)
        self._journal(None, "The investigation goes on.")
        self.asked.told(step)
        if found.verdict == "fit_failed":
            raise End("failed", f"{found.sentence} A further run would not change that.")
        made = diagnosed_model(found, setup, self.rig.motor.gear_ratio)
        save_model(made, self.out / "model.json")
        made = _positive(made)
        with suppress(InputError):  # no model for a design: the one before it goes on
            Bench(made, self.rig, "the diagnosis")
            self.model = made
        return found

    def _follow(self, found: Diagnosis) -> None:
        """The next experiment, recorded. Ends the investigation where the answer is complete."""
        if found.verdict in ("named", "none"):
            raise End("settled", "One answer stands." if found.verdict == "named" else "Nothing material is left.")
        why = "No listed effect explains the error: another run of these kinds would repeat it"
        if found.verdict in ("one_of", "partial"):
            try:
                question = question_in(DiagnosisDocument.of(found).document, "the diagnosis")
            except InputError as error:
                why = f"The diagnosis {error.what}"
            else:
                if self._separate(found, question):
                    return
                why = "No torque within the limits tells the runners-up apart"
        self._move_otherwise(why)

    def _separate(self, found: Diagnosis, question: Question) -> bool:
        """Record what tells the rivals apart; False where no torque does and the verdict leaves other experiments."""
        labels = frozenset(r.label for r in question.rivals)
        past = self.settled.setdefault(labels, [])
        if len(past) >= SETTLED_RUNS and settling_seconds(1.0, sum(past)) <= 1.0:
            raise End("exhausted", f"{len(past)} runs should have told {', '.join(sorted(labels))} apart, and the "
                                    "verdict is the same: none of them is true as modelled. A further run of this kind "
                                    "would not change it.")
        self.clock.require(self.clock.expected_s(SECONDS, 1, self._motion_s, True), "the next step")
        bench, model = self._bench(), self.model
        assert model is not None
        began = self.clock.spent_s
        contest = contest_of(bench, question, model, setup_of([], self.rig, model.provenance.sensors).options)
        with self.clock.limited():
            made = separate(contest, widening_bands(SECONDS, 0.0, self.rig.sampling.planned_hz), self._search(),
                            lambda done, total: self.asked.progress("designing what separates", done / total))
        self.clock.design_s = self.clock.spent_s - began
        if not made.apart:
            if found.verdict == "one_of":
                raise End("exhausted", f"No torque within the limits tells {' and '.join(sorted(labels))} apart, so a "
                                        "further run would not change the answer.")
            return False
        needed_s = max(settling_seconds(made.seconds, ratio) for ratio in made.apart.values())
        repeats, candidate = self._repeated(bench, made.best, int(np.ceil(needed_s / made.seconds)))
        expected = tuple((f"{a} or {b}", repeats * ratio) for (a, b), ratio in made.apart.items())
        past.append(min(ratio for _, ratio in expected))
        why = (f"The torque that tells {', '.join(sorted(labels))} apart soonest: "
               f"{needed_s:.0f} s of it are expected to settle them with 90 % probability.")
        why = " ".join([why, *(f"{line[:1].upper()}{line[1:]}." for line in question.left_out)])
        self._record(candidate.plan, "separate", why, expected)
        return True

    def _repeated(self, bench: Bench, best: Candidate, wanted: int) -> tuple[int, Candidate]:
        """The plan repeated within one run, as often as is wanted, the budget holds and the limits allow."""
        for count in range(min(wanted, REPEATS), 1, -1):
            if self.clock.expected_s(count * SECONDS, 1, self._motion_s, False) < (
                    self.clock.budget_s - self.clock.spent_s):
                torque = np.tile(best.torque_nm, count)
                peak = float(np.abs(torque).max())
                candidate = bench.sized(torque / peak, self.margin, peak)
                if candidate is not None:
                    return count, candidate
        return 1, best

    def _move_otherwise(self, why: str) -> None:
        """Record the most informative kind of motion that no run has had yet, for twice as long."""
        seconds = 2.0 * SECONDS
        self.clock.require(self.clock.expected_s(seconds, 1, self._motion_s, False), "the next step")
        with self.clock.limited():
            motion = next_motion(self._bench(), seconds, self._search(), self.plans, self.kinds)
        if motion is None:
            raise End("exhausted", f"{why}, and every kind of motion was recorded. A further run would not change the "
                                    "answer.")
        self._record(motion.candidate.plan, motion.kind, f"{why}. Another motion, {motion.kind} ({motion.what}): of "
                     "the kinds that no run has had it adds most information "
                     f"(log determinant {2.0 * motion.gain:+.1f}).")

    # -- recordings and the journal ------------------------------------------------------------------------

    def _record(self, plan: Plan, kind: str, why: str, expected: tuple[tuple[str, float], ...] = ()) -> None:
        """One recording, confirmed. Ends the investigation where a person declines, a device fails or limits trip."""
        file = self.out / f"run{len(self.files) + 1:02d}.mcap"
        self.clock.require(self.clock.recording * plan.duration_s + OVERHEAD_S, "the next recording")
        if self.asked.emulate is None and not self.asked.confirm(
                f"{kind}, {plan.duration_s:.0f} s, at most {plan.peak_nm:.3g} N m, to {file}"):
            raise End("declined", f"{file.name} was declined.")
        self.clock.require(self.clock.recording * plan.duration_s + OVERHEAD_S, "the next recording")
        write_plan(plan, self.out / f"plan{len(self.files) + 1:02d}.csv")
        began, ended = self.clock.spent_s, ""
        show = self.asked.progress
        try:
            record_plan(self.rig_path, plan, file, self.asked.emulate, self.asked.seed + len(self.files),
                        lambda done, total: show(f"recording {file.name}", done / total))
        except (WorkError, DriverError) as error:
            ended = str(error)
            if not file.exists():
                raise
        if self.asked.emulate is not None:
            self.clock.recording = (self.clock.spent_s - began) / plan.duration_s
        self.files.append(file)
        self.plans.append(plan)
        self.kinds.add(kind)
        self._pending.append(Experiment(file.name, kind, why, plan.duration_s, plan.peak_nm, expected, ended))
        self._journal(None, "The investigation goes on.")
        if ended and not any(note.kind.startswith("limit ") for note in read_run(file).events):
            by_hand = "stopped by" in ended
            raise End("stopped" if by_hand else "failed", f"{file.name} ended early: {ended}.")
        if ended:
            self.trips += 1
            self.margin *= SMALLER
            if self.trips >= TRIPS:
                raise End("failed", f"{self.trips} runs reached a limit, the last {file.name}: {ended}.")

    def _finish(self, ending: Ending, why: str) -> Investigation:
        if self._pending:
            self.steps.append(Step(tuple(self._pending), None, self.clock.spent_s))
            self._pending = []
            self.asked.told(self.steps[-1])
        return self._journal(ending, why)

    def _journal(self, ending: Ending | None, why: str) -> Investigation:
        """What is known by now, written as JSON and page."""
        steps = list(self.steps)
        if self._pending:
            steps.append(Step(tuple(self._pending), None, self.clock.spent_s))
        done = Investigation(tuple(steps), ending, why, self.clock.budget_s, self.clock.spent_s)
        document = InvestigationDocument.of(done)
        document.provenance = self.origin(self.files)
        document.to_json(self.out / "investigation.json")
        write_investigation(self.out / "investigation.html", document)
        return done

    @property
    def _motion_s(self) -> float:
        """Motion recorded [s]."""
        return sum(plan.duration_s for plan in self.plans)

    def _bench(self) -> Bench:
        assert self.model is not None
        return Bench(self.model, self.rig, "the model")

    def _search(self) -> Search:
        return Search(self.margin, tries=1, steps=40, seed=self.asked.seed + len(self.files))


def _positive(model: Model) -> Model:
    """`model` with a share KNOWN of the largest parameter of the same unit in place of one that is not positive."""
    largest: dict[str, float] = {}
    for one in model.parameters:
        largest[one.unit] = max(one.value, largest.get(one.unit, 0.0))
    return structs.replace(model, parameters=tuple(
        one if one.value > 0.0 else structs.replace(one, value=KNOWN * largest[one.unit]) for one in model.parameters))


def investigate_rig(rig_path: Path | str, out: Path, budget_s: float, asked: Asked,
                    origin: Callable[[list[Path]], Origin]) -> Investigation:
    """Runs of a rig until one cause stands, nothing material is left, or `budget_s` [s] of wall time are spent.

    Everything goes into `out`: runs, plans, a diagnosis a step, the model and the journal. Raises `InputError`, and
    `WorkError` or a `DriverError` where a recording leaves no file.
    """
    return Investigator(rig_path, out, budget_s, asked, origin).run()
