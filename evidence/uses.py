"""`make uses`: does what a fit and a diagnosis say they are good for hold on runs that neither has seen?

Legs of all families of `make evidence`, of which the first runs are fitted and diagnosed by typed commands. The last
runs are then simulated by the model files. Called again it goes on where it stopped.
"""

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from daq import WorkError, load_rig
from estimator import FitError
from estimator.prediction import USE_HORIZONS_S, predict
from estimator.use import ENOUGH, Speed
from evidence.blind import servo, stickslip
from evidence.blind.plan import BENCH, FAMILIES, RECORDS, PlannedCase, plan
from evidence.frame import Lines, new_folder, program, share, table, tell, within
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.models import fitted_model_of, load_model
from experiments.session import as_datasets, prepare

FITTED, NEW = 8, 4
AT_ONCE = 2
LIMIT_S = 600
"""For one command."""
OTHERS = tuple(name for name in FAMILIES if name not in (RECORDS, BENCH))
"""Families whose physics no code of legid computes."""
NOMINAL, EXTENDED = "fit", "diagnosis"


class Held(NamedTuple):
    """One stated figure against one new run."""

    model: str
    what: str
    """Use, or speed of a torque's error."""
    stated: float
    found: float
    within: bool | None
    """None where the figure has no interval"""
    supported: bool


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


def command(words: Sequence[object], folder: Path) -> str:
    """Run `legid WORDS`; what it says last on stderr, empty where it succeeds."""
    try:
        done = subprocess.run([sys.executable, "-m", "legid.cli", *map(str, words)], cwd=folder, capture_output=True,
                              text=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"no answer in {LIMIT_S} s"
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no words"])[-1]


def on_new_runs(label: str, uses: Iterable[Mapping[str, Any]], model: Path, rig: Path, seen: Sequence[Path],
                runs: Sequence[Path]) -> Iterator[Held]:
    """Each figure of `uses` against each of `runs`. They and those `seen` by the fit set the units of errors."""
    found = load_model(model)
    setup = prepare(as_datasets([*seen, *runs], load_rig(rig), False), load_rig(rig), model=found).setup
    errors = predict([fitted_model_of(found)], setup.datasets, setup.options, USE_HORIZONS_S)
    size = errors.samples.max(axis=1)
    driven = list(setup.mechanism.actuated)

    def by_run(squares: np.ndarray, sizes: np.ndarray) -> Iterator[float]:
        for run in range(len(seen), len(seen) + len(runs)):
            inside = errors.run == run
            if sizes[inside].sum() > 0.0:
                yield float(np.sqrt(squares[inside].sum() / sizes[inside].sum()))

    def against(what: str, one: Mapping[str, Any], stated: float, supported: bool, measured: Iterable[float]
                ) -> Iterator[Held]:
        for error in measured:
            inside = None if one["ci95"] is None else one["ci95"][0] <= error <= one["ci95"][1]
            yield Held(label, what, stated, error, inside, supported)

    for one in uses:
        if one["use"] == "simulation":
            horizon = one["horizon_s"] if one["horizon_s"] in USE_HORIZONS_S else inf
            measured = by_run(errors.by_block(horizon)[0] * size, size)
        elif one["use"] == "feedforward":
            measured = by_run(*errors.torques(0, driven))
            for each in one["by_speed"]:
                squares, counts = errors.torques_by_speed(0, each["joint"] - 1)
                k = get_args(Speed).index(each["speed"])
                yield from against(each["speed"], each, each["rms"], False, by_run(squares[k], counts[k]))
        else:
            continue
        yield from against(one["use"], one, one["figure"], one["supported"], measured)


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
        rig, stated = ("--rig", place / "rig.toml"), {}
        answers, models = ({label: folder / f"{label}{end}" for label in (NOMINAL, EXTENDED)}
                           for end in (".json", ".model.json"))
        for verb, label in (("fit", NOMINAL), ("diagnose", EXTENDED)):
            said = command([verb, *runs[:FITTED], *rig, "--json", answers[label], "--model-out", models[label]], folder)
            if answers[label].exists() and models[label].exists():
                stated[label] = json.loads(answers[label].read_text())
            elif label == NOMINAL:
                return Outcome(*about, said)
        held = list[Held]()
        for label, found in stated.items():
            try:
                held += on_new_runs(label, found["uses"], models[label], rig[1], runs[:FITTED], runs[FITTED:])
            except (FitError, WorkError, ValueError) as error:
                tell(case.name, label, error)
        ratios = {}
        if EXTENDED in stated and load_model(models[EXTENDED]).effects:
            seen = [place / name for name in stated[EXTENDED]["runs"]["fit"]]
            command(["fit", *seen, *rig, "--model-out", "nominal.json"], folder)
            both = folder / "both.json"
            command(["compare", models[EXTENDED], "nominal.json", *runs[FITTED:], *rig, "--json", both], folder)
            ratios = gains(json.loads(both.read_text())["errors"]) if both.exists() else {}
        verdict = stated.get(EXTENDED, {}).get("verdict", "none given")
        return Outcome(*about, stated[NOMINAL]["trust"]["sentence"], verdict, tuple(held), ratios)


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
