"""A rig's set-up as its records chose it, for a terminal."""

from __future__ import annotations

from typing import Any

from experiments.console import text_table
from experiments.documents import Number, Time, TuningDocument, finite

TUNING_HEADER = ["entry", "chosen", "why", "what it changes"]


def tuning_rows(document: TuningDocument) -> list[list[str]]:
    """Entry, what was chosen, why and what it changes."""
    return [[f"[{c.table}] {c.key}", f"{c.value:g}" if isinstance(c.value, float) else
             str(list(c.value) if isinstance(c.value, tuple) else c.value), c.why, c.changes] for c in document.chosen]


def tuning_text(document: TuningDocument) -> str:
    """Text for a person: the gain first, then one table."""
    rows = tuning_rows(document)
    what = f"rms prediction error over {document.horizon_s:g} s on held-out runs, by joint"
    if not document.predicts:
        lines = ["nothing is chosen: no fit to half of the runs predicts the other half.",
                 "Run legid fit on the same runs: its first lines say what is wrong."]
    elif rows:
        lines = [f"{len(rows)} {'entry' if len(rows) == 1 else 'entries'} of rig.toml chosen; {what}: "
                 f"{_errors(document.error_before)} before, {_errors(document.error_after)} after",
                 "", text_table(TUNING_HEADER, rows, set())]
    else:
        lines = [f"no change: rig.toml predicts best as it is; {what}: {_errors(document.error_after)}"]
    if document.times:
        lines += ["", "rate, hold and delay were varied together: "
                  + ", ".join(f"{one.what} {_value(one, one.after)} ({_share(one)})" for one in document.times)]
    lines += [f"warning: {run}" for run in document.set_aside]
    lines += [f"warning: {flag}" for flag in document.flags]
    return "\n".join(lines)


def _errors(values: tuple[Number, ...] | None) -> str:
    known = [finite(x) for x in values or (None,)]
    return " and ".join(f"{x:.3g}" for x in known) if all(x < float("inf") for x in known) else "no prediction"


def _share(time: Time) -> str:
    if time.before == time.after:
        return "as it was"
    share = float("inf") if time.gain is None else time.gain
    before = f"instead of {_value(time, time.before)}"
    return f"{before}: error {100 * abs(share):.0f} % {'smaller' if share >= 0.0 else 'larger'}"


def _value(one: Time, value: Any) -> str:
    return {"rate": f"{value:g} Hz", "delay": f"{1e3 * value:.3g} ms"}[one.what] if one.what != "hold" else f"'{value}'"
