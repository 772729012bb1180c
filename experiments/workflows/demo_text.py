"""Text at the end of the demo."""

from __future__ import annotations

import numpy as np

from estimator.prediction import PredictionTable
from experiments.console import text_table
from experiments.documents import DiagnosisDocument
from experiments.judge import number
from experiments.reports import gap_text, size_table
from experiments.workflows.demo_result import Demo


def demo_text(demo: Demo) -> str:
    """Hidden effect, findings, parameters against the truth, and files, for a person."""
    found, mechanism = DiagnosisDocument.of(demo.diagnosis), demo.setup.mechanism
    runs = sum(map(len, demo.diagnosis.runs.values()))
    extended = bool(demo.model.effects)
    lines = [f"Recorded {runs} runs on an emulated leg. Hidden in it: {demo.hidden.words}.", "",
             f"Diagnosis: {found.sentence}"]
    if found.causes:
        lines += ["", size_table(found.causes).text, ""]
    lines += [text for text in (gap_text(found),) if text]
    lines += [_free_run("nominal", demo.before)] + ([_free_run("extended", demo.after)] if extended else [])
    rows = []
    for p, one in zip(mechanism.parameters, demo.estimates().values()):
        truth = demo.truth[p.name]
        rows.append([p.name, number(truth, one.std), number(one.value, one.std), one.interval,
                     "" if one.holds(truth) else "outside", p.unit, p.meaning])
    lines += ["", f"Parameters of the {'extended' if extended else 'nominal'} model:",
              text_table(["parameter", "truth", "found", "95 % interval", "", "unit", "meaning"], rows, {1, 2, 3}), "",
              f"{demo.inside()} of {len(rows)} parameters of the plant lie inside their 95 % intervals.", ""]
    lines += [f"next experiment: {found.next_experiment}", ""] if found.next_experiment else []
    lines += [f"{what + ':':15} {path}" for what, path in demo.files.items()]
    return "\n".join([*lines, "", f"Open {demo.files['report']} in a browser. ({demo.wall_s:.0f} s)"])


def _free_run(which: str, table: PredictionTable) -> str:
    runs = ", ".join(one.run for one in table.runs)
    worst = {name: max(table.rms(0, name, np.inf, k) for k in range(len(table.runs))) for name in ("q1_rad", "q2_rad")}
    return (f"Free-run simulation of {runs} by the {which} model: rms error at most {worst['q1_rad']:.4f} rad at the "
            f"pivot, {worst['q2_rad']:.4f} rad at the knee.")
