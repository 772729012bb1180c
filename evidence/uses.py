"""`make uses`: does what a fit and a diagnosis say they are good for hold on runs that neither has seen?

Legs of all families of `make evidence`, of which the first runs are fitted and diagnosed by typed commands. The last
runs are then simulated by the model files. Called again it goes on where it stopped.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from daq import WorkError
from estimator import FitError
from estimator.use import ENOUGH
from evidence.blind import servo, stickslip
from evidence.blind.plan import BENCH, FAMILIES, RECORDS, PlannedCase, plan
from evidence.frame import Lines, new_folder, program, share, table, tell, within
from evidence.held_uses import Held, on_new_runs
from evidence.kept import kept
from evidence.machines import answer, typed
from evidence.registry import Evidence
from experiments.models import load_model

FITTED, NEW = 8, 4
AT_ONCE = 2
OTHERS = tuple(name for name in FAMILIES if name not in (RECORDS, BENCH))
"""Families whose physics no code of legid computes."""
NOMINAL, EXTENDED = "fit", "diagnosis"


class Outcome(NamedTuple):
    """One leg."""

    family: str
    hidden: str
    seed: int
    sentence: str
    """First line of the fit, or why there is none."""
    verdict: str = ""
    held: tuple[Held, ...] = ()
    ratios: Mapping[float, tuple[float, float, float]] = {}
    """Horizon [s] -> error of the diagnosis' extended model on new runs over that of a fit to the same runs, for the
    sensor in the middle, and its interval. Empty where the diagnosis writes a nominal model."""


@kept
def outcome(case: PlannedCase) -> Outcome:
    """The leg, fitted, diagnosed, and held against its last runs."""
    about = case.family, case.hidden, case.seed
    servo.RUNS = stickslip.RUNS = FITTED + NEW  # of this process of the pool: its makers record as many
    with new_folder() as folder:
        try:
            case.make(folder)
        except Exception as error:  # a maker that fails is no result of legid
            return Outcome(*about, f"not made: {error}")
        place = folder / case.name
        runs = [place / f"r{k}.csv" for k in range(1, FITTED + NEW + 1)]
        rig, stated = place / "rig.toml", {}
        answers, models = ({label: folder / f"{label}{end}" for label in (NOMINAL, EXTENDED)}
                           for end in (".json", ".model.json"))
        for verb, label in (("fit", NOMINAL), ("diagnose", EXTENDED)):
            command = (f"legid {verb} {words(runs[:FITTED])} --rig {rig} --json {answers[label]} "
                       f"--model-out {models[label]}")
            done = typed(command, folder)
            if answers[label].exists() and models[label].exists():
                stated[label] = json.loads(answers[label].read_text())
            elif label == NOMINAL:
                return Outcome(*about, answer(command, done))
        held = list[Held]()
        for label, found in stated.items():
            try:
                held += on_new_runs(label, found["uses"], models[label], rig, runs[:FITTED], runs[FITTED:])
            except (FitError, WorkError, ValueError) as error:
                tell(case.name, label, error)
        ratios = {}
        if EXTENDED in stated and load_model(models[EXTENDED]).effects:
            seen = [place / name for name in stated[EXTENDED]["runs"]["fit"]]
            both = folder / "both.json"
            typed(f"legid fit {words(seen)} --rig {rig} --model-out nominal.json", folder)
            typed(f"legid compare {models[EXTENDED]} nominal.json {words(runs[FITTED:])} --rig {rig} --json {both}",
                  folder)
            ratios = gains(json.loads(both.read_text())["errors"]) if both.exists() else {}
        verdict = stated.get(EXTENDED, {}).get("verdict", "none given")
        return Outcome(*about, stated[NOMINAL]["trust"]["sentence"], verdict, tuple(held), ratios)


def words(runs: Iterable[Path]) -> str:
    """As a command line has them."""
    return " ".join(map(str, runs))


def gains(errors: Iterable[Mapping[str, Any]]) -> dict[float, tuple[float, float, float]]:
    """`Outcome.ratios` of a comparison's errors."""
    found: dict[float, list[tuple[float, float, float]]] = {}
    for one in errors:
        if one["ratio"] is not None and one["ratio_ci95"] is not None:
            low, high = one["ratio_ci95"]
            found.setdefault(one["horizon_s"] or inf, []).append((1.0 / one["ratio"], 1.0 / high, 1.0 / low))
    return {horizon: sorted(some)[len(some) // 2] for horizon, some in found.items()}


def page(legs: int = 60, minutes: float = 45.0, seed: int = 41000, families: Sequence[str] = OTHERS) -> Lines:
    cases = list(islice(plan(families, seed), legs))
    with ProcessPoolExecutor(AT_ONCE) as pool:
        jobs = [pool.submit(outcome, case) for case in cases]
        for job in within(minutes, as_completed(jobs)):
            one = job.result()
            tell(one.family, one.hidden, one.seed, one.verdict, one.sentence, one.ratios)
        pool.shutdown(cancel_futures=True)
    rows = [job.result() for job in jobs if not job.cancelled()]
    held = [one for row in rows for one in row.held]
    yield from [
        "# Uses that were stated, on runs that nothing has seen",
        f"Legs of the families of [causes](causes.md) in random order, seeds from {seed}: {len(rows)} of {legs}. The "
        f"first {FITTED} runs of each were fitted and diagnosed by `legid fit` and `legid diagnose`. Each figure that "
        f"they state was then measured on each of its last {NEW} runs, by the model file."]
    yield table("stated figure | of the fit | of the diagnosis", (
        f"{words} | " + " | ".join(share(one.within for one in held if one.model == label and one.what == what
                                        and one.within is not None) for label in (NOMINAL, EXTENDED))
        for what, words in (("simulation", "error of simulations within its 95 % interval"),
                            ("feedforward", "error of the torque within it"), ("rest", "torque at rest"),
                            ("slow", "torque in slow motion"), ("fast", "torque in fast motion"))))
    yield table("supported use | of the fit | of the diagnosis", (
        f"{what}: the new run errs by at most {100 * ENOUGH:g} % | " + " | ".join(
            share(one.found <= ENOUGH for one in held if one.model == label and one.what == what and one.supported)
            for label in (NOMINAL, EXTENDED)) for what in ("simulation", "feedforward")))
    yield table("family | legs | fits with a use | simulation within | torque within", (
        f"{family} | {len(mine)} | {share(any(one.supported for one in row.held) for row in mine)} | " + " | ".join(
            share(one.within for row in mine for one in row.held if one.what == what and one.within is not None)
            for what in ("simulation", "feedforward"))
        for family in families if (mine := [row for row in rows if row.family == family])))
    yield ("## The model that a diagnosis writes\n\nWhere it has an effect: its error on the new runs over that of a "
           "fit to the runs that it was fitted to, of the sensor in the middle. Worse: the interval of that ratio lies "
           "above 1. Better: below 1.")
    paired = [row for row in rows if row.ratios]
    yield table("horizon | legs | better | worse | median ratio | largest ratio", (
        f"{'whole run' if h == inf else f'{h:g} s'} | {len(some)} | {sum(r[2] < 1.0 for r in some)} | "
        f"{sum(r[1] > 1.0 for r in some)} | {np.median([r[0] for r in some]):.2f} | {max(r[0] for r in some):.2f}"
        for h in sorted({h for row in paired for h in row.ratios})
        if (some := [row.ratios[h] for row in paired if h in row.ratios])))
    if worse := [row for row in paired if any(low > 1.0 for _, low, _ in row.ratios.values())]:
        yield table("worse | hidden | seed | verdict | ratios", (
            f"{row.family} | {row.hidden} | {row.seed} | {row.verdict} | " + ", ".join(
                f"{'whole' if h == inf else f'{h:g} s'}: {value:.3f} [{low:.3f}, {high:.3f}]"
                for h, (value, low, high) in row.ratios.items()) for row in worse))
    if gone := [row for row in rows if not row.held]:
        yield table("without a figure | hidden | seed | answer of the fit", (
            f"{row.family} | {row.hidden} | {row.seed} | {row.sentence}" for row in gone))


EVIDENCE = Evidence(
    "Uses that a fit and a diagnosis state: do their figures hold on new runs?", "make uses", "uses.md", 45,
    "93 to 97 % within; no model of a diagnosis worse than the fit beyond its interval",
    (r"(error of simulations within) its 95 % interval \| ([^|]*?) \(",
     r"(error of the torque within) it \| ([^|]*?) \("))
main = program(page)
