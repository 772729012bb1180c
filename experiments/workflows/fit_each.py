"""Many run files fitted one by one, each alone, on any executor: `legid fit --each`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daq import InputError, Rig, WorkError
from estimator import Method
from experiments.console import text_table
from experiments.documents import FitDocument, finite
from experiments.judge import number
from experiments.provenance import Origin
from experiments.workflows.executor import Executor

SCHEMA = "legid.fits/1"


@dataclass(frozen=True)
class Refit:
    """One run file and how it is fitted; what a worker is handed."""

    run: str
    rig: Rig
    method: Method
    sensors: str | None
    latent: str
    fixed: Mapping[str, float]
    damaged: bool
    """Whether a damaged run is wanted."""
    origin: Origin


def refit(piece: Refit) -> dict[str, Any]:
    """The run's fit JSON with its name, or `error` where the run cannot be read or fitted."""
    from estimator import FitError
    from experiments.workflows.fit import fit_runs

    try:
        found = fit_runs([piece.run], piece.rig, sensors=piece.sensors, fixed=dict(piece.fixed), latent=piece.latent,
                         method=piece.method, damaged=piece.damaged)
    except (FitError, InputError, WorkError) as error:
        return {"run": piece.run, "error": " ".join(str(error).split()), "input": isinstance(error, InputError)}
    made = found.as_document(FitDocument)
    made.provenance = piece.origin
    return {"run": piece.run, **made.document}


def refit_all(pieces: Sequence[Refit], executor: Executor, done: Callable[[int, str], None]) -> list[dict[str, Any]]:
    """Documents in the order of `pieces`; `done(1, run)` is called for each as it finishes."""
    found: dict[int, dict[str, Any]] = {}
    for index, document in executor.run(refit, pieces):
        found[index] = document
        done(1, pieces[index].run)
    return [found[index] for index in range(len(pieces))]


def refits_document(fits: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """`legid.fits/1`: each entry is a `legid.fit/1` with `run` added, or `run` and `error`."""
    return {"schema": SCHEMA, "fits": [{k: v for k, v in fit.items() if k != "input"} for fit in fits]}


def refits_text(fits: Sequence[Mapping[str, Any]]) -> str:
    """One row a run, one column a parameter."""
    good = [fit for fit in fits if "error" not in fit]
    lines = []
    if good:
        names = [p["name"] for p in good[0]["parameters"]]
        rows = [[fit["run"], "yes" if fit["converged"] else "NO",
                 *(number(finite(p["value"]), finite(p["std"])) for p in fit["parameters"])] for fit in good]
        lines.append(text_table(["run", "converged", *names], rows, set(range(2, 2 + len(names)))))
    lines += [f"not fitted: {fit['error']}" for fit in fits if "error" in fit]
    return "\n".join(lines)


def verdict(fits: Sequence[Mapping[str, Any]]) -> int:
    """Exit status: 2 where a run could not be read, 1 where one was not fitted or did not converge, else 0."""
    if any(fit.get("input") for fit in fits):
        return 2
    return int(any("error" in fit or not fit["converged"] for fit in fits))
