"""`make walker`: records of twenty steps by the commands a user types: touchdowns, fits, coverage, diagnoses.

The plant is that of tests/support/walker_plant.py: bodies drawn anew for every case, a landing found as it happens, an
impact of its own. It shares nothing with the estimator.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator, default_rng

from daq import Dataset, FloatArray
from daq.runs import write_csv
from estimator.likelihood import Noise
from estimator.model import biped3
from estimator.signals import find_touchdowns
from evidence.frame import Lines, heard, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from legid.cli.main import main as legid
from tests.support.cramer_rao import fisher_information, inverse_information
from tests.support.walker_plant import (
    Gait,
    Law,
    Plant,
    Sensors,
    Walk,
    no_loss,
    random_walker,
    record,
    roles,
    walk,
)

STEPS, RATE_HZ = 20, 200.0
RUNS, RUN_STEPS, RUN_RATE_HZ = 8, 7, 100.0
"""Of a diagnosis."""
KNOWN_S = 0.005
"""How far a contact's change may be off the landing, both ways."""
PASSIVE_NM = 0.05
RIG = """[mechanism]
model = "biped3"
actuated = [2, 3]
gravity_mps2 = 9.8
[walker]
touchdown_s = {known}
[motor]
gear_ratio = 20.0
[sampling]
rate_hz = {rate}
hold = "zero"
[noise]
torque_nm = {s.torque_nm}
encoder_rad = [{s.torso_rad}, {s.encoder_rad}, {s.encoder_rad}]
passive_nm = {passive}
"""
SENSORS = Sensors()


def typed(*words: object) -> int:
    """Exit status of one command; what it prints is not wanted."""
    with heard():
        return legid([str(word) for word in words])


def walked(plant: Plant, seed: Sequence[int], steps: int, rate_hz: float) -> tuple[Walk, Generator]:
    """A walk; one that falls is drawn anew."""
    for attempt in range(50):
        rng = default_rng([*seed, attempt])
        with suppress(RuntimeError):
            return walk(plant, Gait(), steps, rng, rate_hz, round(400.0 / rate_hz)), rng
    raise RuntimeError(f"the walker of {seed} falls every time")


def put(folder: Path, runs: Sequence[Dataset], rate_hz: float) -> list[Path]:
    """The runs as files, beside rig.toml; file names are the runs'."""
    (folder / "rig.toml").write_text(RIG.format(known=KNOWN_S, rate=rate_hz, s=SENSORS, passive=PASSIVE_NM))
    for data in runs:
        write_csv(data, folder / data.name)
    return [folder / data.name for data in runs]


class Fit(NamedTuple):
    """Of one walk: error of the touchdowns found [s], then with the stance known and found: (beta - truth) over its
    deviation and over the bound's."""

    touchdown: FloatArray
    by_own: dict[str, FloatArray]
    by_bound: dict[str, FloatArray]


def bound(found: Walk, beta: FloatArray) -> FloatArray:
    """(8,) smallest standard deviations of beta over all steps, every sample used."""
    mechanism, noise = biped3(hips=True), Noise(np.array([PASSIVE_NM, SENSORS.torque_nm, SENSORS.torque_nm]),
                                                np.array([SENSORS.torso_rad, *[SENSORS.encoder_rad] * 2]))
    information = sum(fisher_information(mechanism, beta, q, qd, torque, RATE_HZ, "zero", noise)
                      for q, qd, torque in roles(found) if len(q) > 2)
    return np.sqrt(np.diag(inverse_information(np.asarray(information))))


@kept
def fit_walk(seed: int) -> Fit:
    """One body, one walk, two records: a contact that changes up to 5 ms early or late, and none."""
    body = random_walker(default_rng([seed, 1]))
    found, rng = walked(Plant(body), [seed], STEPS, RATE_HZ)
    beta, smallest = body.beta, bound(found, body.beta)
    late = found.touchdown_s + rng.uniform(-KNOWN_S, KNOWN_S, found.touchdown_s.size)
    stance = np.searchsorted(late, found.time_s) % 2 + np.float64(1.0)
    records = {"known": record("known.csv", replace(found, stance=stance), rng, SENSORS),
               "found": record("found.csv", found, rng, SENSORS, stance=False)}
    shown = find_touchdowns(records["found"]).time_s
    own, by_bound = {}, {}
    with new_folder() as folder:
        for what, path in zip(records, put(folder, list(records.values()), RATE_HZ)):
            status = typed("fit", path, "--rig", folder / "rig.toml", "--json", folder / f"{what}.json")
            document = json.loads((folder / f"{what}.json").read_text()) if status == 0 else {}
            if document.get("converged") and all(p["std"] is not None for p in document["parameters"]):
                error = np.array([p["value"] for p in document["parameters"]]) - beta
                own[what] = error / [p["std"] for p in document["parameters"]]
                by_bound[what] = error / smallest
    last = found.touchdown_s[: len(shown)]  # the walk ends as a foot lands: that touchdown is in no record
    return Fit(shown - last if len(shown) == len(last) else np.array([np.inf]), own, by_bound)


Effect = tuple[int | None, Law, Callable[[Dataset], Dataset]]
"""Joint (None: all), law of the hips, what the sensors make of a record."""
Hide = Callable[[Generator], Effect]


def _same(data: Dataset) -> Dataset:
    return data


def _rubbing(force: Callable[[float, float, float], float], low: float, high: float) -> Hide:
    """A torque by (angle, rate, rounded sign of the rate), times a size between `low` and `high`, at one hip."""
    def hide(rng: Generator) -> Effect:
        leg, size = int(rng.integers(2)), rng.uniform(low, high)

        def law(at: int, angle: float, rate: float, torque: float) -> float:
            return size * force(angle, rate, rate / float(np.hypot(rate, 0.02))) if at == leg else 0.0
        return leg + 2, law, _same
    return hide


def _misread(columns: Callable[[int], Sequence[str]], low: float, high: float, one: bool) -> Hide:
    """A constant in columns of one leg, or of both."""
    def hide(rng: Generator) -> Effect:
        leg, size = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))

        def off(data: Dataset) -> Dataset:
            return replace(data, columns={**data.columns, **{name: data[name] + size for name in columns(leg + 2)}})
        return leg + 2 if one else None, no_loss, off
    return hide


HIDDEN: dict[str, Hide] = {
    "joint_stiffness": _rubbing(lambda q, v, s: q, 6.0, 12.0),
    "quadratic_drag": _rubbing(lambda q, v, s: v * abs(v), 0.6, 1.5),
    "torque_offset": _misread(lambda j: ("tau2_nm", "tau3_nm"), 1.5, 3.0, False),
    "asymmetric_friction": _rubbing(lambda q, v, s: max(s, 0.0), 2.0, 5.0),
    "encoder_offset": _misread(lambda j: (f"q{j}_rad",), 0.01, 0.02, True)}


@kept
def look_ahead(seed: int) -> list[dict[str, Any]]:
    """One body, a fit to one walk, put to another by `legid validate`: its free runs across touchdowns."""
    plant = Plant(random_walker(default_rng([seed, 1])))
    runs = [record(f"{name}.csv", *walked(plant, [seed, k, 3], STEPS, RATE_HZ), SENSORS)
            for k, name in enumerate(("fit", "new"))]
    with new_folder() as folder:
        seen, new = put(folder, runs, RATE_HZ)
        model, rig, out = folder / "model.json", folder / "rig.toml", folder / "v.json"
        if typed("fit", seen, "--rig", rig, "--model-out", model):
            return []
        typed("validate", model, new, "--rig", rig, "--json", out)
        ahead: list[dict[str, Any]] = json.loads(out.read_text())["walk"]["ahead"]
    return ahead


def ahead_page(found: Sequence[Sequence[dict[str, Any]]]) -> Iterator[str]:
    """What free runs across touchdowns come to."""
    rows = []
    for n in range(max(map(len, found), default=0)):
        of = [f[n] for f in found if len(f) > n]
        pieces, fell = sum(a["pieces"] for a in of), sum(a["fell"] for a in of)
        weights = np.array([a["pieces"] - a["fell"] for a in of])
        rows.append((n + 1, pieces, fell, *(["all fell"] * 3 if fell == pieces else [
            f"{np.sqrt(np.average([(a['rmse'][f'q{j}_rad'] or 0.0) ** 2 for a in of], weights=weights)):.3f}"
            for j in (1, 2, 3)])))
    yield from ["## Across touchdowns",
                f"`legid validate` of a fit on another walk of the same body, {len(found)} bodies. Free runs start "
                "with each step under measured torques, without a controller. Errors [rad] are of the last of so many "
                "steps."]
    yield table("steps | free runs | fell | torso | hip, standing leg | hip, swinging leg", rows)


class Case(NamedTuple):
    """One diagnosis."""

    seed: int
    hidden: str
    joint: int | None
    verdict: str
    causes: list[tuple[str, int | None]]

    @property
    def right(self) -> bool:
        """Named and nothing else, or nothing where there is nothing."""
        return (self.verdict, self.causes) == (("named", [(self.hidden, self.joint)]) if self.hidden else ("none", []))


@kept
def diagnose(seed: int, hidden: str) -> Case:
    """Eight runs of seven steps of one body, with something hidden or nothing."""
    rng = default_rng([seed, 1])
    body = random_walker(rng)
    joint, law, read = HIDDEN[hidden](rng) if hidden else (None, no_loss, _same)
    plant, runs = Plant(body, law), []
    for k in range(RUNS):
        found, noise = walked(plant, [seed, k, 2], RUN_STEPS, RUN_RATE_HZ)
        runs.append(read(record(f"walk{k}.csv", found, noise, SENSORS)))
    with new_folder() as folder:
        paths = put(folder, runs, RUN_RATE_HZ)
        typed("diagnose", *paths, "--rig", folder / "rig.toml", "--json", folder / "d.json", "--workers", 1)
        document: dict[str, Any] = json.loads((folder / "d.json").read_text())
    return Case(seed, hidden, joint, document["verdict"], [(c["effect"], c["joint"]) for c in document["causes"]])


def fit_page(fits: Sequence[Fit]) -> Iterator[str]:
    """What the fits say."""
    late = 1e3 * np.abs(np.concatenate([f.touchdown for f in fits]))
    rows = []
    for what, told in (("known", "column `stance`, changes up to 5 ms early or late"), ("found", "none: found")):
        own, ratio = (np.array([getattr(f, field)[what] for f in fits if what in f.by_own])
                      for field in ("by_own", "by_bound"))
        each = np.sqrt(np.mean(ratio**2, axis=0))
        inside = np.abs(own) < 1.96
        rows.append(f"{told} | {len(own)} of {len(fits)} | {np.sqrt(np.mean(ratio**2)):.2f} | {each.max():.2f} "
                    f"| {100 * inside.mean():.1f} % +- {100 * inside.mean(axis=1).std() / np.sqrt(len(own)):.1f}")
    yield from ["## Fits",
                f"{len(fits)} walks of {STEPS} steps, a body each, at {RATE_HZ:g} Hz: torso's angle to "
                f"{1e3 * SENSORS.torso_rad:g} mrad, hips' to {1e3 * SENSORS.encoder_rad:g}, torques to "
                f"{SENSORS.torque_nm:g} N m, levels declared. `legid fit` of each walk alone. Error over the "
                "Cramér-Rao bound of all samples, the touchdowns known exactly."]
    yield table("touchdowns | converged | rms error / bound | worst parameter | 95 % intervals that hold", rows)
    yield (f"Touchdowns found: {late.size} of {late.size} to within {late.max():.2f} ms, "
           f"{np.sqrt(np.mean(late**2)):.2f} ms rms."
           if np.isfinite(late).all() else "Touchdowns were missed, or invented.")


def place(effect: str, joint: int | None) -> str:
    return effect if joint is None else f"{effect} at joint {joint}"


def page(fits: int = 24, cases: int = 10, seed: int = 7000) -> Lines:
    kinds = list(HIDDEN)
    yield from ["# Twenty steps of a walker",
                "A planar walker of three bodies (Grizzle, Abba and Plestan 2001) on level ground. A plant of the "
                "tests simulates it: landing is an event, the impact has no slip or rebound. Masses, lengths and "
                "inertias vary by an eighth either way."]
    yield from fit_page([fit_walk(seed + k) for k in range(fits)])
    yield from ahead_page([found for k in range(min(4, fits)) if (found := look_ahead(seed + 300 + k))])
    ill = [diagnose(seed + 100 + k, kinds[k % len(kinds)]) for k in range(cases)]
    healthy = [diagnose(seed + 200 + k, "") for k in range(cases)]
    yield from ["## Diagnoses",
                f"{RUNS} walks of {RUN_STEPS} steps of one body each, at {RUN_RATE_HZ:g} Hz, `legid diagnose`. Named "
                f"alone: {sum(c.right for c in ill)} of {len(ill)} hidden effects; nothing named: "
                f"{sum(c.right for c in healthy)} of {len(healthy)} healthy walkers."]
    yield table("seed | hidden | verdict | causes", (
        f"{c.seed} | {place(c.hidden, c.joint) or 'nothing'} | {c.verdict} | {', '.join(place(*x) for x in c.causes)}"
        for c in (*ill, *healthy)))


EVIDENCE = Evidence(
    "Twenty steps of a walker: touchdowns, fits, free runs, diagnoses", "make walker", "walker.md", 30,
    "every touchdown found, every hidden effect named alone, no cause named on healthy walkers",
    (r"Touchdowns found: \d+ of \d+", r"(Named) alone: (\d+ of \d+ hidden effects)",
              r"nothing named: \d+ of \d+ healthy walkers"))
main = program(page)
