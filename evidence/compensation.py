"""Causes of emulated legs undone by their drives: how far the knee is from that of the leg without the cause.

    python -m evidence compensation --out docs/evidence/compensation.md
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from evidence.registry import Evidence
from experiments.emulation.hidden_effects import EFFECTS, NOTHING, Hidden
from experiments.models import EffectValue
from experiments.workflows import cogging_settings, feedforward
from tests.support.compensated_leg import (
    ASYMMETRIC,
    DIRECT,
    PLAN,
    RIPPLE,
    SPRING,
    VALUE,
    apart,
    direct,
    extended,
    record,
)

EVIDENCE = (
    Evidence("A named cause undone by the drive", "make compensation", "compensation.md", 2,
             "a tenth of the error at most", (r"\d+ of \d+ within a tenth",)),)
DRIVES = ("legid", "moteus", "odrive", "dynamixel")
CASES: tuple[tuple[str, Hidden, EffectValue, tuple[str, ...]], ...] = (
    ("spring of 0.45 N m/rad", EFFECTS["joint_stiffness"], SPRING, DRIVES),
    ("friction that is 0.03 N m higher one way", EFFECTS["asymmetric_friction"], ASYMMETRIC, DRIVES),
    ("ripple of 0.15 N m, seven times a turn", RIPPLE, VALUE, DRIVES))


def measure(folder: Path) -> list[tuple[str, str, str, float, float]]:
    """Cause, drive, by what, and the knee's distance before and after [rad]."""
    rows = []
    for name, hidden, value, drives in CASES:
        model = extended(folder, value)
        plan = feedforward(model, PLAN, "m.json").plan
        for kind in drives:
            clean, before = (record(folder, kind, PLAN, one) for one in (NOTHING, hidden))
            rows.append((name, kind, "plan", apart(before, clean), apart(record(folder, kind, plan, hidden), clean)))
            if hidden is RIPPLE and kind == "moteus":
                settings = cogging_settings(model, direct(kind)[0], DIRECT.__getitem__, "m.json")
                after = record(folder, kind, PLAN, hidden, settings)
                rows.append((name, kind, "cogging table", apart(before, clean), apart(after, clean)))
    return rows


def page(rows: Sequence[tuple[str, str, str, float, float]]) -> str:
    """The dated page."""
    good = sum(after <= 0.1 * before for *_, before, after in rows)
    lines = [
        f"# A cause undone by the drive, {datetime.now(UTC):%Y-%m-%d}", "",
        "By `make compensation`: an emulated leg records a plan of 8 s without the cause, with it, and compensated. "
        "`legid compensate` adds torque to the plan, or makes a table for the drive. The cause has its true size. "
        "The distance is the knee's from the leg without the cause, rms. No real drive was tried.", "",
        f"- {good} of {len(rows)} within a tenth of the distance before.", "",
        "| cause | drive | by | before [mrad] | after [mrad] |", "| --- | --- | --- | ---: | ---: |"]
    lines += [f"| {name} | {kind} | {by} | {1e3 * before:.1f} | {1e3 * after:.1f} |"
              for name, kind, by, before, after in rows]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print or write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="the page to write; printed without it")
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        text = page(measure(Path(folder)))
    args.out.write_text(text, encoding="utf-8") if args.out else print(text)
    return 0
