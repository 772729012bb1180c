"""`make separate`: does the torque that `legid excite --separate` designs name the truth more often than the usual one?

Emulated legs with a fault and four runs by the gentle multisine that `legid excite` writes without a model. Where their
diagnosis ends `one_of` with the fault among its causes, one more run is recorded twice: by the designed torque, and by
the default design of the same length. Each is diagnosed with the same four runs. A fault has the size at which the
information of the four plans leaves its nearest rival almost as likely, while it is far above noise. Called again it
goes on where it stopped.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import structs
from scipy.stats import binomtest

from daq import FloatArray, InputError, Rig, WorkError
from daq.recording import Plan
from estimator.diagnosis import Diagnosis
from estimator.effects import library
from evidence.blind.score import Rate
from evidence.emulated_legs import causes_of, label, leg_of, rig_in
from evidence.kept import kept
from evidence.page_file import within, write_page
from evidence.registry import Evidence
from experiments.documents import DiagnosisDocument
from experiments.emulation import LegBody, record_emulated
from experiments.excite import (
    USUAL_HIGH_HZ,
    Bench,
    Contest,
    Question,
    Rival,
    Search,
    contest_of,
    design,
    question_in,
    random_multisine,
    separate,
    widening_bands,
)
from experiments.judge import diagnosed_model
from experiments.models import (
    Model,
    ParameterValue,
    Provenance,
    build_mechanism,
    mechanism_settings,
)
from experiments.session import Setup, prepare, setup_of
from experiments.workflows import diagnose_prepared
from studies import machine

SEED, RUNS, SECONDS, MORE_S = 5151, 4, 5.0, 2.5
"""... runs that go before, their length, and that of the run that is added [s]."""
GENTLE_NM, LIMIT_NM, LOW_HZ, HIGH_HZ = 0.2, 0.3, 0.2, 2.5
"""Peak of the first runs, the rig's limit, and the frequencies of the first runs."""
TIES = (3.0, 6.0)
"""Twice the expected log likelihood ratio, over the first runs, of a fault over its nearest rival of the library: a
diagnosis does not tell apart what differs by less than 5.9."""
PRIOR = 0.03
"""Standard deviation of the prior model's parameters about the legs'."""

FAULTS: dict[str, int | None] = {"imu_misalignment": None, "accelerometer_bias": None, "encoder_offset": 2}
"""Fault -> its joint, from 1: those that the first runs show by far, at sizes that a leg can have, while a rival is
almost as likely. A torque offset and asymmetric friction are left out: no run tells them apart."""


class Outcome(NamedTuple):
    """One leg with one fault."""

    verdict: str
    """After the first runs"""
    rivals: tuple[str, ...]
    size: float
    score: float
    """Standard deviations by which the first runs show it"""
    designed: tuple[str, tuple[str, ...]] | None
    """Verdict and causes with the designed run; None where the first runs do not end `one_of` with the fault."""
    usual: tuple[str, tuple[str, ...]] | None
    ratios: tuple[float, float] = (0.0, 0.0)
    """Expected log likelihood ratio of the fault over its nearest rival by the designed and by the usual run"""
    seconds: float = 0.0
    """Time that this took"""


def faulty(effect: str, size: float, rig: Rig) -> Rig:
    """The rig as it is, of whose fault the rig file knows nothing."""
    c = rig.calibration
    if effect == "encoder_offset":
        other = structs.replace(c, knee_zero_rad=c.knee_zero_rad + size)
    elif effect == "accelerometer_bias":
        moved = np.array(c.accel_bias_mps2) + size * np.array(c.imu_mount[0])  # along link 1's motion
        other = structs.replace(c, accel_bias_mps2=tuple(moved.tolist()))
    else:
        turn = np.array([[np.cos(size), -np.sin(size), 0.0], [np.sin(size), np.cos(size), 0.0], [0.0, 0.0, 1.0]])
        other = structs.replace(c, imu_mount=tuple(map(tuple, (turn @ np.array(c.imu_mount)).tolist())))
    return structs.replace(rig, calibration=other)


def prior_of(rig: Rig, body: LegBody, number: int) -> Model:
    """A model a little off the leg, as first runs give it."""
    rng, settings = np.random.default_rng([SEED, number, 1]), mechanism_settings(rig)
    mechanism = build_mechanism(settings)
    values = np.array(body.beta()) * (1.0 + PRIOR * rng.standard_normal(mechanism.p))
    return Model(schema="legid.model/1", mechanism=settings, noise={}, hold="linear",
                 parameters=tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(v))
                                  for p, v in zip(mechanism.parameters, values)),
                 covariance=tuple(map(tuple, np.diag((PRIOR * values) ** 2).tolist())),
                 provenance=Provenance(runs=(), method="mle", sensors="imu", date="2026-01-01T00:00:00+00:00",
                                       version="evidence"))


def tied_size(bench: Bench, rig: Rig, prior: Model, effect: str, torques: Sequence[FloatArray], tie: float
              ) -> tuple[float, float]:
    """Size of the fault at which the runs under these torques leave `tie` over its nearest rival of the whole library,
    and the standard deviations by which they show it."""
    effects = library(bench.mechanism, True)[0]
    rivals = tuple(Rival(e.name, None if e.joint is None else e.joint + 1, {e.sizes[0].name: e.sizes[0].scale})
                   for e in effects)
    contest = contest_of(bench, Question(rivals), prior, setup_of([], rig, "imu").options)
    moved = [contest.bench.fine.move(torque) for torque in torques]
    whole = np.sum([contest.information(one) for one in moved if one is not None], axis=0)
    place = [one.effect == effect and FAULTS[effect] in (None, one.joint) for one in rivals].index(True)
    left = contest.ratios(whole).reshape(len(rivals), len(rivals) - 1)[place].min()
    factor = np.sqrt(tie / left)
    scale = next(iter(rivals[place].sizes.values()))
    return float(factor * scale), float(factor * np.sqrt(contest.left(whole, rivals[place])))


@kept
def outcome(effect: str, tie: float, number: int) -> Outcome:
    """One leg with the fault of such a size that its nearest rival is `tie` less likely."""
    began, truth, body = time.perf_counter(), label(effect, FAULTS[effect]), leg_of(SEED, number)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rig, text = rig_in(folder)
        rig = structs.replace(rig, limits=structs.replace(rig.limits, torque_nm=LIMIT_NM))
        prior = prior_of(rig, body, number)
        search = Search(seed=number)
        plans = [random_multisine(100 * number + k, SECONDS, GENTLE_NM, low_hz=LOW_HZ, high_hz=HIGH_HZ)
                 for k in range(RUNS)]
        options = setup_of([], rig, "imu").options
        size, score = tied_size(Bench(prior, rig, "prior"), rig, prior, effect, [p.torque_nm for p in plans], tie)
        own = faulty(effect, size, rig)

        def recorded(name: str, plan: Plan, k: int) -> Path:
            record_emulated(folder / name, own, text, plan, 100 * number + k, body)
            return folder / name

        files = [recorded(f"run{k}.mcap", plan, k) for k, plan in enumerate(plans)]
        first, setup = diagnosed(files, rig)
        found = causes_of(first)
        if first.verdict != "one_of" or truth not in found:
            return Outcome(first.verdict, found, size, score, None, None, seconds=time.perf_counter() - began)
        model = diagnosed_model(first, setup, rig.motor.gear_ratio)
        try:
            bench = Bench(model, rig, "the diagnosis")
        except InputError:  # of a model with a parameter that is not positive
            return Outcome(first.verdict, found, size, score, None, None, seconds=time.perf_counter() - began)
        contest = contest_of(bench, question_in(DiagnosisDocument.of(first).document, "the diagnosis"), model, options)
        ends, ratios = [], []
        bands = widening_bands(MORE_S, 0.0, rig.sampling.planned_hz)
        for k, one in enumerate((separate(contest, bands, search).best, design(bench, bands[0], search).best)):
            try:
                last = diagnosed([*files, recorded(f"more{k}.mcap", one.plan, 50)], rig)[0]
                ends.append((last.verdict, causes_of(last)))
            except WorkError:  # a limit ended the run
                ends.append(("fit_failed", ()))
            ratios.append(nearest(contest, one.torque_nm, truth))
    return Outcome(first.verdict, found, size, score, ends[0], ends[1], (ratios[0], ratios[1]),
                   time.perf_counter() - began)


def diagnosed(files: Sequence[Path], rig: Rig) -> tuple[Diagnosis, Setup]:
    """The ordinary diagnosis of the runs, and its set-up."""
    prepared = prepare(files, rig)
    return diagnose_prepared(prepared, workers=1), prepared.setup


def nearest(contest: Contest, torque: FloatArray, truth: str) -> float:
    """Smallest expected log likelihood ratio of the truth over a rival by one run under this torque."""
    moved = contest.bench.fine.move(torque)
    if moved is None:
        return 0.0
    names = [r.label for r in contest.question.rivals]
    ratios = 0.5 * contest.ratios(contest.information(moved)).reshape(len(names), len(names) - 1)
    return float(ratios[names.index(truth)].min())


def truth_alone(effect: str, end: tuple[str, tuple[str, ...]]) -> bool:
    """Whether the diagnosis names the fault and nothing else."""
    return end == ("named", (label(effect, FAULTS[effect]),))


def wrong(effect: str, end: tuple[str, tuple[str, ...]]) -> bool:
    """Whether it names something that is not there."""
    verdict, causes = end
    return verdict in ("named", "partial") and set(causes) != {label(effect, FAULTS[effect])}


def page(legs: int, wanted: int, minutes: float) -> Iterator[str]:
    """The page, line by line."""
    rows: list[tuple[str, float, Outcome]] = []
    for number, tie, effect in within(minutes, product(range(legs), TIES, FAULTS)):
        if sum(one.designed is not None for _, _, one in rows) >= wanted:
            break
        rows.append((effect, tie, outcome(effect, tie, number)))
        print(effect, tie, number, rows[-1][2], flush=True)
    open_ = [(effect, one) for effect, _, one in rows if one.designed is not None and one.usual is not None]
    count = len(open_)
    designed = [truth_alone(effect, one.designed) for effect, one in open_ if one.designed]
    usual = [truth_alone(effect, one.usual) for effect, one in open_ if one.usual]
    only = [sum(a and not b for a, b in zip(designed, usual)), sum(b and not a for a, b in zip(designed, usual))]
    chance = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
    least = [float(np.median([o.ratios[k] for _, o in open_])) if count else np.nan for k in range(2)]
    spent = sum(one.seconds for _, _, one in rows) / 60.0
    yield from [
        "# The torque that tells rivals apart", "",
        f"Made by `make separate MINUTES={minutes:g}` (seed {SEED}), {datetime.now(UTC):%Y-%m-%d}, {machine()}, "
        f"{spent:.0f} minutes of one core that other work shared.", "",
        f"Emulated legs with one fault each, {RUNS} runs of {SECONDS:g} s, a diagnosis. The runs are the gentle "
        f"multisine of {GENTLE_NM:g} N m that `legid excite` writes without a model. The information of these plans "
        "gives the size of a fault. Twice its log likelihood ratio over its nearest rival of the library is expected "
        f"to be {TIES[0]:g} or {TIES[1]:g}. A diagnosis does not tell apart what differs by less than 5.9.", "",
        f"{count} of {len(rows)} diagnoses end `one_of` with the fault among the causes; {wanted} of these "
        "were asked for.", "",
        "| fault | standard deviations | verdict after the first runs | causes |", "| --- | ---: | --- | --- |"]
    for effect, _, one in rows:
        yield (f"| {label(effect, FAULTS[effect])} | {one.score:.1f} | {one.verdict} | {', '.join(one.rivals)} |")
    if not open_:
        yield from ["", "So no designed run could be compared with a usual one. Faults of these sizes are not "
                    "material, or the first runs name them.", ""]
        return
    yield from [
        "", f"To each of the {count} one run of {MORE_S:g} s is added, by the designed torque or by the default "
        f"design. Both may use {LIMIT_NM:g} N m. The default design has frequencies up to {USUAL_HIGH_HZ:g} Hz, the "
        "designed torque up to a twelfth of the sampling rate. Its bands were chosen by expected ratios on four "
        "legs of another seed.", "",
        "| | designed torque | default design |", "| --- | --- | --- |",
        f"| the fault alone is named | {Rate(sum(designed), count)} | {Rate(sum(usual), count)} |",
        f"| something else is named | {Rate(sum(wrong(e, o.designed) for e, o in open_ if o.designed), count)} | "
        f"{Rate(sum(wrong(e, o.usual) for e, o in open_ if o.usual), count)} |",
        f"| the other run fails, this one names the fault | {only[0]} | {only[1]} |",
        f"| expected log likelihood ratio over the nearest rival, median | {least[0]:.3g} | {least[1]:.3g} |", "",
        f"The chance of so unequal counts without a difference is {chance:.2g} (sign test).",
        *(["The designed run names the fault less than twice as often. Its expected ratio is "
           f"{least[0] / least[1]:.2g} times that of the default design."]
          * (sum(designed) < 2 * sum(usual))), "",
        "| fault | designed torque | default design | ratio, designed | ratio, default |",
        "| --- | --- | --- | ---: | ---: |"]
    for effect, one in open_:
        ends = [f"{end[0]}: {', '.join(end[1])}" if end else "-" for end in (one.designed, one.usual)]
        yield (f"| {label(effect, FAULTS[effect])} | {ends[0]} | {ends[1]} | {one.ratios[0]:.3g} | "
               f"{one.ratios[1]:.3g} |")
    yield ""


EVIDENCE = (
    Evidence("The torque that tells rivals apart: does one run of it name the fault?", "make separate",
             "separate.md", 25, "named twice as often as by the default design, nothing wrong",
             (r"(\d+ of \d+ diagnoses end `one_of`)", r"the fault alone is (named) \| ([^|]*\))",
              r"(default design) \|\n.*\n\| the fault alone is named \|[^|]*\| ([^|]*\))")),)


def main(arguments: Sequence[str] | None = None) -> None:
    write_page(page, __doc__, arguments, legs=(20, "at most"), wanted=(30, "diagnoses that end one_of"),
               minutes=(20.0, "after which no other leg is begun"))
