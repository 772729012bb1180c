"""A whole session of plans, in an order that shows every kind to every part of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from daq import FloatArray, InputError, WorkError, input_errors, read_bytes
from daq.recording import write_plan
from estimator import CAUSED
from estimator.effects import Effect, PlanKind
from experiments.console import make_directory, write_json
from experiments.excite.optimal_design import (
    RATE_HZ,
    Band,
    Bench,
    Candidate,
    Design,
    Search,
    condition_number,
    design,
    standard_errors,
)
from experiments.excite.waveforms import KINDS, USUAL
from experiments.models import known_effects

SCHEMA = "legid.excitation/1"
INDEX = "session.json"
TURN = 4
"""Kinds of plans that follow each other: of as many runs alike in excitation a diagnosis holds one out."""


@dataclass(frozen=True)
class Choice:
    """Kinds of plans that alternate, and the reason."""

    kinds: tuple[PlanKind, ...]
    """TURN of them."""
    reasons: tuple[str, ...]
    by_hand: tuple[str, ...] = ()


@dataclass(frozen=True)
class SessionPlan:
    """One plan of a session."""

    file: str
    kind: PlanKind
    candidate: Candidate


@dataclass(frozen=True)
class PlannedSession:
    """All plans, and the first design, whose first draw is what they are compared with."""

    plans: tuple[SessionPlan, ...]
    design: Design
    choice: Choice

    @property
    def information(self) -> FloatArray:
        """(p, p) of all plans together."""
        return np.asarray(np.sum([p.candidate.information for p in self.plans], axis=0))

    @property
    def before(self) -> FloatArray:
        """(p, p) of as many first draws."""
        return len(self.plans) * self.design.first.information


def usual_choice() -> Choice:
    """The kinds that look for anything."""
    return Choice(USUAL, tuple(f"{kind}: {KINDS[kind].what}" for kind in USUAL))


def next_choice(path: Path | str) -> Choice:
    """The kinds that the causes of a diagnosis call for. Raises `InputError` where the file is no diagnosis."""
    where = str(path)
    try:
        with input_errors(path, "give the JSON of legid diagnose"):
            found = msgspec.json.decode(read_bytes(path))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise InputError(where, "is not JSON", "give the JSON of legid diagnose") from None
    if not isinstance(found, dict) or found.get("schema") != "legid.diagnosis/1":
        raise InputError(where, "is no legid.diagnosis/1", "give the JSON of legid diagnose --json")
    causes, verdict = found.get("causes"), found.get("verdict")
    if not isinstance(causes, list) or not all(isinstance(c, dict) and isinstance(c.get("effect"), str)
                                               for c in causes):
        raise InputError(where, "`causes` is no list of effects", "give the JSON of legid diagnose --json")
    names = list(dict.fromkeys(str(c["effect"]) for c in causes))
    library = known_effects()
    known = [library[name] for name in names if name in library and library[name].plans is not None]
    if verdict not in CAUSED or not known:
        told = f"the verdict is {verdict!r}"
        told += " of causes that no kind of plan is known for" if verdict in CAUSED else ""
        usual = usual_choice()
        return replace(usual, reasons=(f"{told}: all usual kinds", *usual.reasons))
    return chosen_for(known)


def chosen_for(effects: Sequence[type[Effect]]) -> Choice:
    """`large` first, then in turn what each of the effects calls for, `small` where there is room."""
    wanted: dict[PlanKind, list[str]] = {}
    for rank in range(2):  # every effect's first kind before any one's second
        for effect in effects:
            for kind in (effect.plans or ())[rank:rank + 1]:
                wanted.setdefault(kind, []).append(effect.name)
    kinds, left = list(wanted)[: TURN - 1], list(wanted)[TURN - 1:]
    if len(kinds) < TURN - 1:
        kinds.insert(1 if kinds else 0, "small")
    order: tuple[PlanKind, ...] = ("large", *kinds)
    order += {2: order, 3: (kinds[0],)}.get(len(order), ())
    reasons = [f"{kind}: {KINDS[kind].what}" + (f"; for {', '.join(wanted[kind])}" if kind in wanted else "")
               for kind in dict.fromkeys(order)]
    reasons += [f"{kind} is left out, for there are {TURN} turns: {KINDS[kind].what}; for {', '.join(wanted[kind])}"
                for kind in left]
    reasons += [f"{effect.name}: large and small are all that it needs" for effect in effects if not effect.plans]
    return Choice(order, tuple(reasons), tuple(f"{effect.name}: {effect.by_hand}" for effect in effects
                                               if effect.by_hand))


def plan_session(bench: Bench, band: Band, search: Search, choice: Choice, runs: int,
                 progress: Callable[[str, float], None] | None = None) -> PlannedSession:
    """All plans, each within the limits by simulation. Raises `InputError` or `WorkError`.

    Run i is of kind (i mod 4 + i div 4) mod 4: each four have all kinds, and after sixteen every part of a diagnosis
    has seen all. Every realisation of a kind is drawn anew, but the k-th `small` is half the k-th `large`.
    """
    time_s = np.arange(round(band.seconds * RATE_HZ)) / RATE_HZ
    plans: list[SessionPlan] = []
    designs: list[Design] = []
    turns: dict[PlanKind, int] = {}

    def designed(k: int) -> Design:
        while len(designs) <= k:
            designs.append(design(bench, band, replace(search, seed=search.seed * 1000 + len(designs))))
        return designs[k]

    for i in range(runs):
        kind = choice.kinds[(i % TURN + i // TURN) % TURN]
        if progress is not None:
            progress(kind, i / runs)
        turn = turns[kind] = turns.get(kind, -1) + 1
        if kind == "large":
            candidate: Candidate | None = designed(turn).best
        elif kind == "small":
            torque = designed(turn).best.torque_nm
            peak = float(np.abs(torque).max())
            candidate = bench.sized(torque / peak, search.margin, KINDS[kind].share * peak)
        else:
            candidate = _shaped(bench, kind, time_s, search, i)
        if candidate is None:
            raise WorkError(f"no plan of the kind {kind!r} keeps the limits; widen [limits]")
        plans.append(SessionPlan(f"{i + 1:02d}-{kind}.csv", kind, candidate))
    return PlannedSession(tuple(plans), designs[0], choice)


def _shaped(bench: Bench, kind: PlanKind, time_s: FloatArray, search: Search, run: int) -> Candidate | None:
    """A plan of a kind that no optimiser designs, as large as the limits allow; None where no size keeps them."""
    shape = KINDS[kind].shape
    assert shape is not None
    wave = shape(time_s, np.random.default_rng((search.seed, run)))
    return bench.sized(wave / np.abs(wave).max(), KINDS[kind].share * search.margin)


def write_session(session: PlannedSession, folder: Path, rig: str, model: str, margin: float) -> None:
    """The plans and their index into `folder`. Raises `InputError` where that cannot be written."""
    make_directory(folder)
    for plan in session.plans:
        write_plan(plan.candidate.plan, folder / plan.file)
    write_json(folder / INDEX, session_document(session, rig, model, margin))


def session_document(session: PlannedSession, rig: str, model: str, margin: float) -> dict[str, Any]:
    """`legid.excitation/1`; a standard error is null where that plan alone leaves the parameter open."""
    names = session.design.names
    return {
        "schema": SCHEMA, "rig": rig, "model": model, "margin": margin,
        "chosen": list(session.choice.reasons), "by_hand": list(session.choice.by_hand),
        "plans": [{"file": p.file, "kind": p.kind, "what": KINDS[p.kind].what,
                   "seconds": p.candidate.plan.duration_s, "peaks": p.candidate.peaks,
                   "std": dict(zip(names, p.candidate.std.tolist()))} for p in session.plans],
        "session": {"seconds": sum(p.candidate.plan.duration_s for p in session.plans),
                    "condition_before": condition_number(session.before),
                    "condition_after": condition_number(session.information),
                    "std_before": dict(zip(names, standard_errors(session.before).tolist())),
                    "std": dict(zip(names, standard_errors(session.information).tolist()))},
    }


def session_text(session: PlannedSession, folder: Path) -> str:
    """Choice with its reason, the plans in order, and their joint prediction, for a person."""
    lines = [*session.choice.reasons, *(f"by hand: {text}" for text in session.choice.by_hand), ""]
    for p in session.plans:
        peak = ", ".join(f"{name} {value:.3g}" for name, value in p.candidate.peaks.items())
        lines.append(f"{p.file:<14}  {peak}")
    after, before = standard_errors(session.information), standard_errors(session.before)
    minutes = sum(p.candidate.plan.duration_s for p in session.plans) / 60.0
    told = ", ".join(f"{name} {100 * s / abs(b):.2g} %" for name, s, b in zip(session.design.names, after,
                                                                             session.design.beta))
    lines += ["", f"{len(session.plans)} plans, {minutes:.1f} min, in {folder} with {INDEX}; condition number before "
              f"{condition_number(session.before):.1f} (as many first draws), after "
              f"{condition_number(session.information):.1f}",
              f"predicted standard errors of all together: {told}; "
              f"{float(np.exp(np.mean(np.log(after / before)))):.2f} of as many first draws' in the mean"]
    if len(session.plans) < TURN * TURN:
        lines.append(f"fewer than {TURN * TURN} runs do not give each part of a diagnosis every kind of run")
    return "\n".join(lines)
