"""A diagnosis as a page, in the order in which a person asks: what is wrong, how much, how sure, what next."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimator import Verdict
from estimator.diagnosis import Cause, Diagnosis, ShortRuns
from estimator.model import Mechanism
from estimator.signals import angle_column
from experiments.documents import untestable
from experiments.judge import Files, Level, next_step, with_names
from experiments.provenance import Origin
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
    BUDGET_HEADER,
    ERROR_HEADER,
    PARAMETERS,
    ROTATION_HEADER,
    SMALL_HEADER,
    SMALL_TITLE,
    answer_words,
    budget_rows,
    budget_words,
    causes_title,
    detectable_text,
    effect_label,
    error_rows,
    gain_text,
    gap_text,
    hold_words,
    key_label,
    parameter_rows,
    probability,
    rotation_rows,
    rotation_words,
    share_text,
    short_title,
    size_rows,
    size_text,
    small_rows,
)
from experiments.reports.figures import on_paper
from experiments.reports.html import Picture, Section, Table, VerdictBox, fold, write_page
from experiments.reports.origin import origin_section
from experiments.reports.sketch import sketch_pictures
from experiments.reports.structure import structure_section
from experiments.session import Prepared, contradictions

FLAT = 0.1
"""Share of an effect's curve below which the nominal residual is flat next to it."""
ALPHA = 0.01
"""p above which a candidate counts as ruled out at its smallest detectable size."""


def write_diagnosis(path: Path | str, found: Diagnosis, prepared: Prepared, origin: Origin,
                    files: Files | None = None) -> None:
    """Write the page of a diagnosis of the runs in `prepared`. The next step names `files`.

    Raises `InputError` where `path` cannot be written.
    """
    setup = prepared.setup
    write_page(path, f"Diagnosis of {setup.settings.model}: {verdict_words(found.verdict)}", confirm_words(found),
               [*diagnosis_sections(found, setup.mechanism), origin_section(origin, setup.datasets)], origin,
               verdict_box(found, contradictions(prepared.flags), files))


def confirm_words(found: Diagnosis) -> str:
    """Runs that the verdict depends on."""
    used = sum(len(names) for names in found.runs.values())
    if not found.confirm_runs:
        return f"From {used} runs." if used else ""
    turns = " These were inconclusive, so every run was held out once." if found.rotations else ""
    held_out = ", ".join(found.confirm_runs)
    return f"From {used} runs, {len(found.confirm_runs)} of them held out: {held_out}.{turns}"


LEVELS: dict[Verdict, Level] = {"none": "good", "named": "good", "partial": "caution", "one_of": "caution",
                               "unexplained": "caution", "fit_failed": "bad"}
"""Of an answer, not of the leg."""
WORDS: dict[Verdict, str] = {
    "none": "nothing beyond noise", "named": "cause named", "partial": "cause named, something is left",
    "one_of": "one of several causes", "unexplained": "something is wrong, cause unknown", "fit_failed": "not possible"}


def verdict_box(found: Diagnosis, warnings: Sequence[str] = (), files: Files | None = None) -> VerdictBox:
    """The answer and every warning, for the head of a page."""
    words = verdict_words(found.verdict)
    return VerdictBox(LEVELS[found.verdict], f"{words[:1].upper()}{words[1:]}",
                   [*filter(None, [found.sentence, answer_words(found)])],
                   [f"Warning: {text}" for text in (*warnings, *found.warnings)],
                   f"Next step: {with_names(next_step(found), files)}")


def verdict_words(verdict: Verdict) -> str:
    """The verdict for a heading."""
    return WORDS[verdict]


def diagnosis_sections(found: Diagnosis, mechanism: Mechanism | None = None) -> list[Section]:
    """All sections, folded, in the order of the questions; those that have nothing to show are left out. `mechanism`
    says what the numbers mean; warnings are `verdict_box`'s. One figure leads the page."""
    return fold([_verdict(found), structure_section(found.structure), _sketch(found, mechanism), _budget(found),
                _errors(found), _candidates(found), _signatures(found), _traces(found),
                _separability(found), _parameters(found, mechanism), _next(found), _ruled_out(found),
                _untestable(found), _runs(found)])


def _sketch(found: Diagnosis, mechanism: Mechanism | None) -> Section:
    """The mechanism in the run drawn below; a joint that no encoder reads is drawn as at rest."""
    title = "The mechanism"
    if mechanism is None or not found.traces:
        return Section(title)
    first = found.traces[0]
    rest = np.zeros_like(first.time_s)
    poses = np.stack([first.measured.get(angle_column(mechanism, j), rest) for j in range(mechanism.n)], axis=1)
    return Section(title, pictures=sketch_pictures(mechanism, poses, first.time_s, first.run))


def _verdict(found: Diagnosis) -> Section:
    header = ["effect", "size", "value", "95 % interval", "unit"]
    rows = [row for cause in found.causes for row in size_rows(cause)]
    notes = [_about(cause) for cause in found.causes]
    tables = [Table(header, rows, right=frozenset({2, 3}))] if rows else []
    if small := small_rows(found):
        tables.append(Table(SMALL_HEADER, small, SMALL_TITLE[:1].lower() + SMALL_TITLE[1:], frozenset({2, 3})))
    return Section(causes_title(found), (), tables, (), notes)


def _budget(found: Diagnosis) -> Section:
    if not found.budget:
        return Section("What the error consists of")
    small = [row for cause in found.immaterial for row in size_rows(cause)]
    tables = [Table(BUDGET_HEADER, budget_rows(found), right=frozenset({1, 2}))]
    if small:
        tables.append(Table(["effect", "size", "value", "95 % interval", "unit"], small,
                            "present, not material", frozenset({2, 3})))
    left = found.remainder
    where = [] if left is None else [f"The residual is largest in {left.channel}, as a function of {left.depends_on}."]
    turns = []
    if found.rotations:
        turns.append(rotation_words(found))
        tables.append(Table(ROTATION_HEADER, rotation_rows(found), "every run held out once", frozenset({2})))
    return Section("What the error consists of", [budget_words(found), *turns, *where], tables,
                   [Picture(waterfall(found.budget), "Mean squared free-run error of the nominal model: what each "
                            "cause takes away, what the extended model leaves beyond noise, and noise alone.")])


def _about(cause: Cause) -> str:
    text = f"{effect_label(cause.effect, cause.joint)}: {cause.sentence}."
    if cause.p_value < 1.0:
        text += f" p = {probability(cause.p_value)}.".replace("= <", "<")
    near = ", ".join(key_label(key) for key in cause.confusable_with)
    return f"{text} In these runs it looks much like {near}." if near else text


def _errors(found: Diagnosis) -> Section:
    if not found.sensors:
        return Section("How far the simulation is off")
    rows = error_rows(found.sensors)
    before, after = found.torque_rms_nm
    rows += [[f"torque residual, joint {j + 1} [N m]", f"{b:.4g}", f"{a:.4g}", ""]
             for j, (b, a) in enumerate(zip(before, after))]
    tables = [Table(ERROR_HEADER, rows, "rms errors, in the unit of the sensor", frozenset({1, 2, 3})),
              *short_tables(found.short)]
    return Section(
        "How far the simulation is off",
        [f"Free-run simulation of {', '.join(found.confirm_runs)}: one initial state, then the measured torque alone. "
         "These runs were not used to fit or to choose. " + gap_text(found)],
        tables,
        [Picture(error_bars(found.sensors), "Free-run error by sensor, in the sensor's own unit. The error of noise "
                 "alone is measured on bootstrap replicates: records simulated by the extended model.",
                 leads=not found.traces)])


def short_tables(short: ShortRuns | None) -> list[Table]:
    """The errors in pieces, where they were taken."""
    if short is None:
        return []
    caption = f"{short_title(short)}. {share_text(short.sensors, short.closed, short.ci95)}"
    return [Table(ERROR_HEADER, error_rows(short.sensors), caption, frozenset({1, 2, 3}))]


def _candidates(found: Diagnosis) -> Section:
    if not found.candidates:
        return Section("Candidates")
    header = ["effect", "score", "gain", "p", "size", "smallest detectable", "unit", "looks much like"]
    near = _neighbours(found)
    labels = _labels(found)
    rows = [[labels[c.effect, c.joint], f"{c.score:.1f}", gain_text(c.score**2), probability(c.p_value),
             size_text(c), detectable_text(c), c.unit, near.get((c.effect, c.joint), "")]
            for c in found.candidates]
    return Section(
        "Candidates",
        ["Every effect of the library, scored individually; the nominal parameters may absorb part of it. "
         "One cause raises the scores of similar effects. So the best are fitted in full before one is named. "
         "The score counts standard deviations. The gain is twice the log likelihood, divided by the scatter between "
         "runs. p is corrected for the number of effects tried."],
        [Table(header, rows, right=frozenset({1, 2, 3, 4, 5}))])


def _labels(found: Diagnosis) -> dict[tuple[str, int | None], str]:
    """Of candidates: with the joint where two would be called alike, though it is one effect of the whole rig."""
    alike = Counter(effect_label(c.effect, c.joint) for c in found.candidates)
    return {(c.effect, c.joint): label if alike[label] == 1 or c.joint is None else f"{label}, joint {c.joint}"
            for c in found.candidates for label in [effect_label(c.effect, c.joint)]}


def _neighbours(found: Diagnosis, least: float = 0.7) -> dict[tuple[str, int | None], str]:
    keys, cosines = found.separability
    out: dict[tuple[str, int | None], str] = {}
    for i, key in enumerate(keys):
        near = sorted((j for j in range(len(keys)) if j != i and abs(cosines[i, j]) > least),
                      key=lambda j: -abs(float(cosines[i, j])))
        name, _, joint = key.partition("@")
        out[name, int(joint) if joint else None] = "; ".join(key_label(keys[j]) for j in near[:3])
    return out


def _signatures(found: Diagnosis) -> Section:
    seen = [s for s in found.signatures if float(np.max(np.abs(s.before))) > FLAT * float(np.max(np.abs(s.curve)))]
    absorbed = [f"{key_label(s.title)}: the nominal parameters absorb it, so the residual has no signature of it."
                for s in found.signatures if s not in seen]
    limits = signature_limits(seen)
    pictures = [Picture(signature_plot(s, limits[s.x_label, s.y_label]),
                        f"{key_label(s.title)}: residual of the nominal model (mean and standard error of each bin), "
                        "the effect's law, and the residual of the extended model. The nominal parameters absorb part "
                        "of an effect, so their residual need not follow its curve.")
                for s in seen]
    return Section("Signature", (), (), pictures, absorbed)


def _traces(found: Diagnosis) -> Section:
    if not found.traces:
        return Section("Before and after")
    first = found.traces[0]
    shown = [column for column in first.measured if column in first.before and column in first.after]
    at = re.compile("|".join(rf"q{joint}_" for joint in _joints(found)) or r"(?!)")
    told = max(shown, key=lambda column: (bool(at.match(column)), column.startswith("q"), _excess(found, column)),
               default="")
    paper = on_paper(TRACE_SECONDS, float(first.time_s[-1] - first.time_s[0]))
    pictures = [Picture(trace_plot(first, column), f"{column} in run {first.run}: measured, and simulated by the "
                        f"nominal and by the extended model; below, simulated less measured.{paper}",
                        trace_chart(first, column), leads=column == told)
                for column in shown]
    return Section("Simulation against measurement, before and after", (), (), pictures)


def _joints(found: Diagnosis) -> list[int]:
    """Joints from 1 at which the causes are, or the residual where none is named."""
    joints = [cause.joint for cause in found.causes] or [found.remainder.joint if found.remainder else None]
    return [joint for joint in joints if joint is not None]


def _excess(found: Diagnosis, column: str) -> float:
    """Error of the nominal model over that of noise alone."""
    gain = found.sensors.get(column)
    return gain.before / max(gain.floor, 1e-300) if gain else 0.0


def _separability(found: Diagnosis) -> Section:
    keys, cosines = found.separability
    if len(keys) < 2:
        return Section("What can be told apart")
    picture = Picture(heat_map([key_label(key) for key in keys], cosines),
                      "Cosine between the changes that two effects make in these runs, projected off the nominal "
                      "parameters. Near 1 or -1 these runs cannot tell the two apart. Columns are numbered like rows.")
    return Section("What can be told apart", (), (), [picture])


def _parameters(found: Diagnosis, mechanism: Mechanism | None) -> Section:
    if not found.nominal:
        return Section("Parameters")
    meanings = {p.name: [p.unit, p.meaning] for p in (mechanism.parameters if mechanism else ())}
    told = ["unit", "meaning"] if meanings else []
    header, rows = parameter_rows(found)
    rows = [[*row, *(meanings.get(row[0], ["", ""]) if meanings else [])] for row in rows]
    table = Table([*header, *told], rows, right=frozenset(range(1, len(header))))
    if not found.extended:
        return Section("Parameters", (), [table])
    pairs = ({name: (value, std.get(name, float("inf"))) for name, value in values.items()}
             for values, std in ((found.nominal, found.nominal_std), (found.extended, found.extended_std)))
    return Section("What the extension does to the parameters", [PARAMETERS], [table],
                   [Picture(shift_plot(*pairs), "Parameters of the extended model against those of the nominal one.")])


def _next(found: Diagnosis) -> Section:
    return Section("Next experiment", [found.next_experiment] if found.next_experiment else [])


def _ruled_out(found: Diagnosis) -> Section:
    gone = [c for c in found.candidates if c.p_value > ALPHA]
    if not gone:
        return Section("Ruled out")
    labels = _labels(found)
    rows = [[labels[c.effect, c.joint], detectable_text(c), c.unit] for c in gone]
    return Section(
        "Ruled out",
        ["None of these is detected at or above the size given. These runs would not show smaller sizes. "
         "None: the nominal parameters imitate the effect, so these runs cannot test it."],
        [Table(["effect", "smallest detectable", "unit"], rows, right=frozenset({1}))])


def _untestable(found: Diagnosis) -> Section:
    rows = [[effect_label(effect, joint), why] for effect, joint, why in untestable(found)]
    return Section("What cannot be tested here", (), [Table(["effect", "why"], rows)] if rows else ())


def _runs(found: Diagnosis) -> Section:
    uses = {"fit": "fitted; all causes were chosen by them", "confirm": "held out until the causes were chosen"}
    rows = [[use, ", ".join(found.runs[group])] for group, use in uses.items() if found.runs.get(group)]
    return Section("Runs", [hold_words(found)] if found.hold else (), [Table(["use", "runs"], rows)] if rows else ())
