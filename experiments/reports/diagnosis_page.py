"""A diagnosis as a page, in the order in which a person asks: what is wrong, how much, how sure, what next."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from estimator.diagnosis import Diagnosis
from estimator.signals import angle_column
from experiments.documents import DiagnosisDocument, NamedCause, finite, split_key
from experiments.judge import VERDICTS, Files
from experiments.reports.diagnosis_figures import (
    TRACE_SECONDS,
    error_bars,
    heat_map,
    shift_plot,
    signature_limits,
    signature_plot,
    trace_chart,
    trace_plot,
    waterfall,
)
from experiments.reports.diagnosis_text import (
    PARAMETERS,
    budget_table,
    budget_words,
    candidate_label,
    causes_title,
    detectable_text,
    effect_label,
    error_table,
    gap_text,
    hold_words,
    key_label,
    parameter_table,
    probability,
    rotation_table,
    rotation_words,
    size_table,
    size_text,
    untestable_section,
)
from experiments.reports.figures import on_paper
from experiments.reports.html import Picture, Section, Table, fold
from experiments.reports.origin import write_result
from experiments.reports.sketch import sketch_pictures
from experiments.reports.structure import structure_section

FLAT = 0.1
"""Share of an effect's curve below which the nominal residual is flat next to it."""
ALPHA = 0.01
"""p above which a candidate counts as ruled out at its smallest detectable size."""
NEAR, MOST_NEAR = 0.7, 3
"""Cosine beyond which two effects look much alike, and how many of an effect's neighbours are named."""


def write_diagnosis(path: Path | str, found: DiagnosisDocument, kept: Diagnosis | None = None,
                    files: Files | None = None) -> None:
    """Write the page of a diagnosis, with the curves of its own result where that was `kept`. The next step names
    `files`.

    Raises `InputError` where `path` cannot be written.
    """
    write_result(path, found, f"Diagnosis{' of ' * bool(found.model)}{found.model}: {VERDICTS[found.verdict][1]}",
                 confirm_words(found), diagnosis_sections(found, kept), files)


def confirm_words(document: DiagnosisDocument) -> str:
    """Runs that the verdict depends on."""
    used = len(document.runs.fit + document.runs.screen + document.runs.confirm)
    if not document.confirm_runs:
        return f"From {used} runs." if used else ""
    turns = " These were inconclusive, so every run was held out once." if document.rotations else ""
    held_out = ", ".join(document.confirm_runs)
    return f"From {used} runs, {len(document.confirm_runs)} of them held out: {held_out}.{turns}"


def diagnosis_sections(document: DiagnosisDocument, kept: Diagnosis | None = None) -> list[Section]:
    """All sections, folded, in the order of the questions; those that have nothing to show are left out. Curves over
    time and space come from the result that was `kept`. One figure leads the page."""
    kept = kept or Diagnosis(document.verdict, document.sentence)
    uses = {"fitted; all causes were chosen by them": document.runs.fit,
            "held out until the causes were chosen": document.runs.confirm}
    return fold(
        Section(causes_title(document), (), [size_table(document.causes)] if document.causes else [], (),
                [_about(cause) for cause in document.causes]),
        structure_section(document, kept.structure), _sketch(kept), _budget(document), _errors(document, kept),
        _candidates(document, kept), _signatures(kept), _traces(document, kept), _separability(kept),
        _parameters(document, kept), Section("Next experiment", [*filter(None, [document.next_experiment])]),
        _ruled_out(document),
        untestable_section(document.not_testable),
        Section("Runs", [*filter(None, [hold_words(document)])], [Table(["use", "runs"], [
            [use, ", ".join(names)] for use, names in uses.items() if names])] if any(uses.values()) else ()))


def _sketch(kept: Diagnosis) -> Section | None:
    """The mechanism in the run drawn below; a joint that no encoder reads is drawn as at rest."""
    mechanism = kept.mechanism
    if mechanism is None or not kept.traces:
        return None
    first = kept.traces[0]
    rest = np.zeros_like(first.time_s)
    poses = np.stack([first.measured.get(angle_column(mechanism, j), rest) for j in range(mechanism.n)], axis=1)
    return Section("The mechanism", pictures=sketch_pictures(mechanism, poses, first.time_s, first.run))


def _budget(found: DiagnosisDocument) -> Section | None:
    if not found.budget:
        return None
    tables = [budget_table(found), size_table(found.immaterial, "present, not material"),
              *([rotation_table(found)] if found.rotations else [])]
    left = found.remainder
    return Section(
        "What the error consists of", [budget_words(found), *([rotation_words(found)] if found.rotations else []),
                                       *([] if left is None else [f"The residual is largest in {left.channel}, as a "
                                                                  f"function of {left.depends_on}."])],
        [table for table in tables if table.rows],
        [Picture(waterfall(found.budget), "Mean squared free-run error of the nominal model: what each cause takes "
                 "away, what the extended model leaves beyond noise, and noise alone.")])


def _about(cause: NamedCause) -> str:
    text = f"{effect_label(cause.effect, cause.joint)}: {cause.meaning}."
    if cause.p_value < 1.0:
        text += f" p = {probability(cause.p_value)}.".replace("= <", "<")
    near = ", ".join(cause.confusable_with)
    return f"{text} In these runs it looks much like {near}." if near else text


def _errors(found: DiagnosisDocument, kept: Diagnosis) -> Section | None:
    if not found.sensors:
        return None
    table, torques = error_table(found.sensors), found.gain.torque_rms_nm
    rows = [[f"torque residual, joint {j} [{found.force_unit}]", f"{finite(b):.4g}", f"{finite(a):.4g}", ""]
            for j, (b, a) in enumerate(zip(torques.before, torques.after), 1)]
    return Section(
        "How far the simulation is off",
        [f"Free-run simulation of {', '.join(found.confirm_runs)}: one initial state, then the measured torque alone. "
         "These runs were not used to fit or to choose. " + gap_text(found)],
        [replace(table, rows=[*table.rows, *rows], caption="rms errors, in the unit of the sensor")],
        [Picture(error_bars(found.sensors), "Free-run error by sensor, in the sensor's own unit. The error of noise "
                 "alone is measured on bootstrap replicates: records simulated by the extended model.",
                 leads=not kept.traces)])


def _candidates(document: DiagnosisDocument, kept: Diagnosis) -> Section | None:
    if not document.candidates:
        return None
    near = _neighbours(kept)
    rows = [[candidate_label(c), f"{c.score:.1f}", _gain(c.score**2), probability(c.p_value), size_text(c),
             detectable_text(c), c.unit, near.get(effect_label(c.effect, c.motor or c.joint), "")]
            for c in document.candidates]
    return Section(
        "Candidates",
        ["Every effect of the library, scored individually; the nominal parameters may absorb part of it. "
         "One cause raises the scores of similar effects. So the best are fitted in full before one is named. "
         "The score counts standard deviations. The gain is twice the log likelihood, divided by the scatter between "
         "runs. p is corrected for the number of effects tried."],
        [Table(["effect", "score", "gain", "p", "size", "smallest detectable", "unit", "looks much like"], rows,
               range(1, 6))])


def _gain(gain: float) -> str:
    """A gain in log likelihood to three digits, without an exponent."""
    return f"{gain:.3g}" if gain < 999.5 else f"{gain:.0f}"


def _neighbours(kept: Diagnosis) -> dict[str, str]:
    """Label of an effect, with its joint and as the contract has it -> effects that look much like it."""
    keys, cosines = kept.separability
    out: dict[str, str] = {}
    for i, key in enumerate(keys):
        near = sorted((j for j in range(len(keys)) if j != i and abs(cosines[i, j]) > NEAR),
                      key=lambda j: -abs(float(cosines[i, j])))
        out[key_label(key)] = out[effect_label(*split_key(key))] = "; ".join(
            key_label(keys[j]) for j in near[:MOST_NEAR])
    return out


def _signatures(kept: Diagnosis) -> Section:
    seen = [s for s in kept.signatures if float(np.max(np.abs(s.before))) > FLAT * float(np.max(np.abs(s.curve)))]
    absorbed = [f"{key_label(s.title)}: the nominal parameters absorb it, so the residual has no signature of it."
                for s in kept.signatures if s not in seen]
    limits = signature_limits(seen)
    pictures = [Picture(signature_plot(s, limits[s.x_label, s.y_label]),
                        f"{key_label(s.title)}: residual of the nominal model (mean and standard error of each bin), "
                        "the effect's law, and the residual of the extended model. The nominal parameters absorb part "
                        "of an effect, so their residual need not follow its curve.")
                for s in seen]
    return Section("Signature", (), (), pictures, absorbed)


def _traces(document: DiagnosisDocument, kept: Diagnosis) -> Section | None:
    if not kept.traces:
        return None
    first = kept.traces[0]
    shown = [column for column in first.measured if column in first.before and column in first.after]
    at = re.compile("|".join(rf"q{joint}_" for joint in _joints(kept)) or r"(?!)")
    told = max(shown, key=lambda column: (bool(at.match(column)), column.startswith("q"), _excess(document, column)),
               default="")
    paper = on_paper(TRACE_SECONDS, float(first.time_s[-1] - first.time_s[0]))
    pictures = [Picture(trace_plot(first, column), f"{column} in run {first.run}: measured, and simulated by the "
                        f"nominal and by the extended model; below, simulated less measured.",
                        trace_chart(first, column), column == told, paper)
                for column in shown]
    return Section("Simulation against measurement, before and after", (), (), pictures)


def _joints(kept: Diagnosis) -> list[int]:
    """Joints from 1 at which the causes are, or the residual where none is named."""
    joints = [cause.joint for cause in kept.causes] or [kept.remainder.joint if kept.remainder else None]
    return [joint for joint in joints if joint is not None]


def _excess(document: DiagnosisDocument, column: str) -> float:
    """Error of the nominal model over that of noise alone."""
    gain = document.sensors.get(column)
    return gain.before / max(gain.floor, 1e-300) if gain else 0.0


def _separability(kept: Diagnosis) -> Section | None:
    keys, cosines = kept.separability
    return None if len(keys) < 2 else Section("What can be told apart", pictures=[Picture(
        heat_map([key_label(key) for key in keys], cosines),
        "Cosine between the changes that two effects make in these runs, projected off the nominal parameters. Near 1 "
        "or -1 these runs cannot tell the two apart. Columns are numbered like rows.")])


def _parameters(document: DiagnosisDocument, kept: Diagnosis) -> Section | None:
    table, given = parameter_table(document), document.parameters
    if not table.rows:
        return None
    if kept.mechanism is not None:
        meanings = {p.name: [p.unit, p.meaning] for p in kept.mechanism.parameters}
        table = replace(table, header=[*table.header, "unit", "meaning"],
                        rows=[[*row, *meanings.get(row[0], ["", ""])] for row in table.rows])
    if not given.extended:
        return Section("Parameters", (), [table])
    pairs = ({name: (finite(value), inf if stds.get(name) is None else finite(stds[name]))
              for name, value in values.items()} for values, stds in
             ((given.nominal, given.nominal_std), (given.extended, given.extended_std)))
    return Section("What the extension does to the parameters", [PARAMETERS], [table],
                   [Picture(shift_plot(*pairs), "Parameters of the extended model against those of the nominal one.")])


def _ruled_out(document: DiagnosisDocument) -> Section | None:
    named = {(c.effect, c.joint) for c in document.causes}
    rows = [[candidate_label(c), detectable_text(c), c.unit] for c in document.candidates
            if c.p_value > ALPHA and (c.effect, c.joint) not in named]
    return Section(
        "Ruled out",
        ["None of these is detected at or above the size given. These runs would not show smaller sizes. "
         "None: the nominal parameters imitate the effect, so these runs cannot test it."],
        [Table(["effect", "smallest detectable", "unit"], rows, {1})]) if rows else None
