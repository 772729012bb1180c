"""The casebook as a page and as lines for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.calibrate import CHECK, FOUND, check_rows, found_rows, open_terms
from experiments.documents import DiagnosisDocument, segment_of
from experiments.judge import number
from experiments.reports import (
    BLUE,
    ORANGE,
    Line,
    Picture,
    Section,
    Table,
    error_bars,
    error_table,
    gap_text,
    key_label,
    picture_lines,
    segment_table,
    signature_limits,
    signature_plot,
    size_table,
    trace_plot,
    write_page,
)
from studies.casebook import Calibrated, Diagnosed, Fitted, Study, Swept, values

SECONDS = 12.0


def write_casebook(path: Path | str, studies: Sequence[Study]) -> None:
    """Write the page. Raises `InputError` where that place cannot be written."""
    sections = [_overview(studies), *(section for study in studies for section in study_sections(study))]
    write_page(path, "Casebook: published against found",
               f"{len(studies)} set{'s' * (len(studies) != 1)} of public records, each put through fit, validate and "
               "diagnose with the rig file shipped for it.", sections)


def _overview(studies: Sequence[Study]) -> Section:
    """One row a set: what is published against what was found."""
    header = ["records", "farthest from what is published", "diagnosis", "free run of held-out records (rms)"]
    rows = []
    for study in studies:
        fits = [f"{off[0]} {100 * off[1]:.3g} % ({f.task.title})" for f in study.fits if (off := worst_departure(f))]
        fits += [f"refused ({f.task.title})" for f in study.fits if f.result is None]
        told = [f"{_verdict_in_short(d)} ({d.task.rig})" for d in study.diagnoses]
        gains = [f"{column} {g.before:.2g} to {g.after:.2g}" for d in study.diagnoses if d.found is not None
                 for column, g in d.found.sensors.items()]
        rows.append([study.case.title, "; ".join(fits), "; ".join(told), "; ".join(gains)])
    return Section("At a glance", [], [Table(header, rows)])


def _verdict_in_short(d: Diagnosed) -> str:
    """Verdict, effects, and whether that is what is published."""
    if d.found is None:
        return "refused"
    words = d.found.verdict + (": " + ", ".join(key_label(name) for name in d.named) if d.named else "")
    agreed = ", as published" if set(d.named) == set(d.task.expected) else ", what is published among them"
    words += {None: "", True: agreed, False: ", not what is published"}[d.agrees()]
    return words if d.steady else words + ", but not with every seed"


def study_sections(study: Study) -> list[Section]:
    """Sections: the published facts, then every fit, then every diagnosis."""
    title = study.case.title
    return [Section(title, [" ".join(study.case.known.split()), f"Source: {study.case.source}."]),
            *[_fit_section(title, f) for f in study.fits], *_side_by_side(study),
            *[_sweep_section(title, w) for w in study.sweeps],
            *[_diagnosis_section(title, d) for d in study.diagnoses],
            *[_calibration_section(title, c) for c in study.calibrations]]


def study_text(study: Study) -> str:
    """A few lines for a terminal."""
    lines = [f"{study.case.title} ({study.case.folder})"]
    for f in study.fits:
        lines.append(f"  {f.task.title}, {f.task.method}: {_fit_words(f)}")
    lines += [f"  {_sweep_words(w, method)}" for w in study.sweeps for method in w.task.methods]
    for d in study.diagnoses:
        lines.append(f"  diagnosis with {d.task.rig}: {_verdict_words(d)}")
    lines += [f"  IMU against encoder: {_calibration_words(c)}" for c in study.calibrations]
    return "\n".join(lines)


def worst_departure(f: Fitted) -> tuple[str, float] | None:
    """Parameter that is farthest from its published value, and by what share; None where nothing can be compared."""
    if f.result is None or not f.task.published:
        return None
    found = values(f.result)
    off = {name: abs(found[name] / value - 1.0) for name, value in f.task.published.items()}
    worst = max(off, key=lambda name: np.nan_to_num(off[name], nan=np.inf))
    return worst, float(off[worst])


def _fit_words(f: Fitted) -> str:
    if f.result is None:
        return f"refused: {f.refusal}"
    words = [] if f.result.converged else ["DID NOT CONVERGE"]
    off = worst_departure(f)
    words += [] if off is None else [f"within {100 * off[1]:.3g} % of what is published ({off[0]} is farthest)"]
    errors = [f"{e:.2f}" for e in f.relative_error_percent() if np.isfinite(e)]
    words += [f"relative error {', '.join(errors)} %"] if errors else []
    left = ", ".join(f"{r:.3g}" for r in f.result.torque_residual_rms)
    return "; ".join([*words, f"residual {left} {f.result.mechanism.force_unit}"])


def _verdict_words(d: Diagnosed) -> str:
    if d.found is None:
        return f"refused: {d.refusal}"
    ending = {None: "", True: " What is published is named.",
              False: f" Published is {', '.join(d.task.expected)}: the program does NOT name it."}[d.agrees()]
    more = sorted(set(d.named) - set(d.task.expected)) if d.task.expected else []
    ending += f" Named beyond what is published: {', '.join(more)}." if more else ""
    return f"{d.found.verdict}. {d.found.sentence}{ending}{_repeated_words(d)}"


def _repeated_words(d: Diagnosed) -> str:
    """How the same diagnosis ends with other seeds of its bootstrap replicates."""
    if not d.others or d.found is None:
        return ""
    same = sum(other == d.ending for other in d.others)
    counts = ", ".join(f"{verdict} {sum(v == verdict for v, _ in d.others)}"
                       for verdict in sorted({v for v, _ in d.others}))
    edge = "" if d.steady else ": it stands at the edge of what these records can show"
    return f" Of {len(d.others)} repetitions with other seeds {same} end alike ({counts}){edge}."


def _fit_section(title: str, f: Fitted) -> Section:
    heading = f"{title}: {f.task.title}"
    words = _fit_words(f)
    about = f"{f.task.method} with {f.task.rig} on {', '.join(f.task.runs)}. {words[:1].upper()}{words[1:]}."
    if f.result is None:
        return Section(heading, [about])
    rows = []
    found = values(f.result)
    for p, std in zip(f.result.mechanism.parameters, f.result.std):
        published, value = f.task.published.get(p.name), found[p.name]
        known = published is not None
        given = p.name in f.task.fix
        rows.append([p.name, f"{published:.5g}" if known else "", number(value, float(std)),
                     "given" if given else number(float(std), float(std)),
                     f"{100 * (value / published - 1):+z.2f} %" if published else "", p.unit, p.meaning])
    header = ["parameter", "published", "found", "std", "departure", "unit", "meaning"]
    shown = [k for k, name in enumerate(header) if f.task.published or name not in ("published", "departure")]
    tables = [Table([header[k] for k in shown], [[row[k] for k in shown] for row in rows],
                    {i for i, k in enumerate(shown) if 1 <= k <= 4})]
    if f.task.relative_error_percent:
        tables.append(Table(["relative error", "published", "found"], [
            [f"joint {j + 1}", f"{a:.2f} %", f"{b:.2f} %"]
            for j, (a, b) in enumerate(zip(f.task.relative_error_percent, f.relative_error_percent()))],
            {1, 2}))
    if f.validations:
        tables.append(segment_table([segment_of(one) for one in f.validations],
                                    "free-run simulation of runs that the fit has not seen"))
    notes = [f"not determined: {name}" for name in f.result.undetermined]
    notes += [f"validation refused: {f.validation_refusal}"] if f.validation_refusal else []
    return Section(heading, [about], tables, _torque_pictures(f), notes)


def _sweep_words(w: Swept, method: str) -> str:
    """How far a method misses what is published over all bandwidths."""
    off = [w.departure(method, cutoff) for cutoff in w.task.cutoffs_hz]
    low, high = min(w.task.cutoffs_hz), max(w.task.cutoffs_hz)
    if not all(off):
        return f"{method} from {low:g} to {high:g} Hz: refused at one bandwidth or more"
    return (f"{method} from {low:g} to {high:g} Hz: within "
            f"{100 * max(abs(v) for o in off for v in o.values()):.3g} % of what is published")


def _sweep_section(title: str, w: Swept) -> Section:
    names = list(w.task.published)
    rows = []
    for method in w.task.methods:
        for cutoff in w.task.cutoffs_hz:
            found, off = w.found[method, cutoff], w.departure(method, cutoff)
            cells = [found, *[""] * (len(names) - 1)] if isinstance(found, str) else \
                [f"{100 * off[n]:+.1f} %" for n in names]
            rows.append([method, f"{cutoff:g} Hz", *cells])
    about = (f"With {w.task.rig} on {', '.join(w.task.runs)}: departure from what is published by the bandwidth of "
             f"[filter] cutoff_hz. {'; '.join(_sweep_words(w, m) for m in w.task.methods)}. Least squares on filtered "
             "motion shrinks as the noise in the motion grows; where the errors of the motion are estimated with it, "
             "the filter only makes the start.")
    return Section(f"{title}: bandwidth", [about],
                   [Table(["method", "cutoff", *names], rows, range(1, len(names) + 2))])


def _side_by_side(study: Study) -> list[Section]:
    """Residuals of several fits of one model to the same records that differ in what was given."""
    fits = [(f, f.result) for f in study.fits if f.result is not None]
    if len({(f.task.rig, f.task.runs, f.task.method) for f, _ in fits}) != 1 or len(fits) < 2:
        return []
    rows = []
    for k, parameter in enumerate(fits[0][1].mechanism.parameters):
        spread = [float(r.std[k]) for _, r in fits]
        cells = ["given" if parameter.name in f.task.fix
                 else f"{number(values(r)[parameter.name], std)} ± {number(std, std)}"
                 for (f, r), std in zip(fits, spread)]
        rows.append([parameter.name, parameter.meaning, *cells])
    unit = fits[0][1].mechanism.force_unit
    rows += [["", f"residual, joint {j + 1} [{unit}]", *[f"{r.torque_residual_rms[j]:.4g}" for _, r in fits]]
             for j in range(fits[0][1].mechanism.n)]
    header = ["parameter", "meaning", *[f.task.title for f, _ in fits]]
    return [Section(f"{study.case.title}: forms of the model side by side",
                    ["A friction term below zero would drive the joint: it stands for another form of friction."],
                    [Table(header, rows, range(2, len(header)))])]


def _torque_pictures(f: Fitted) -> list[Picture]:
    if f.result is None or not f.result.trajectories:
        return []
    path = f.result.trajectories[0]
    unit = f.result.mechanism.force_unit
    return [picture_lines(path.time_s, [Line("measured", path.tau_measured[:, j], BLUE, 2.2),
                                        Line("model", path.tau[:, j], ORANGE, 0.9)], f"joint {j + 1} [{unit}]",
                          f"What drives joint {j + 1} in {path.run}, measured and as the model has it.", SECONDS,
                          group=f"{f.task.title} {path.run}")
            for j in f.result.mechanism.actuated]


def _diagnosis_section(title: str, d: Diagnosed) -> Section:
    heading = f"{title}: diagnosis with {d.task.rig}"
    about = [f"With {d.task.rig} on {', '.join(d.task.runs)}.", f"Verdict: {_verdict_words(d)}"]
    if d.found is None:
        return Section(heading, about)
    found, told = d.found, DiagnosisDocument.of(d.found)
    tables, pictures = [], []
    sizes = [[*row[:2], f"{d.task.published[row[1]]:.4g}" if row[1] in d.task.published else "", *row[2:]]
             for row in size_table(told.causes).rows]
    if sizes:
        tables.append(Table(["effect", "size", "published", "found", "95 % interval", "unit"], sizes, {2, 3, 4}))
    if found.sensors:
        rows = [*error_table(found.sensors).rows]
        rows += [[f"residual over the torque that drives joint {j + 1}", f"{b:.2f} %", f"{a:.2f} %", ""]
                 for j, (b, a) in enumerate(zip(*d.residual_percent())) if np.isfinite(b)]
        tables.append(Table(["rms error", "nominal", "extended", "noise alone"], rows, {1, 2, 3},
                            f"on the held-out runs {', '.join(found.confirm_runs)}. {gap_text(told)}"))
        pictures.append(Picture(error_bars(found.sensors), "Free-run error by sensor."))
    limits = signature_limits(found.signatures)
    pictures += [Picture(signature_plot(s, limits[s.x_label, s.y_label]), f"{key_label(s.title)}: the residual, "
                         "and what the effect adds.") for s in found.signatures]
    for trace in found.traces[:1]:
        pictures += [Picture(trace_plot(trace, column), f"{column} in {trace.run}: measured, nominal, extended.")
                     for column in trace.measured if column in trace.before and column in trace.after]
    return Section(heading, about, tables, pictures, [f"Warning: {text}" for text in found.warnings])


def _calibration_words(c: Calibrated) -> str:
    if c.found is None:
        return f"refused: {c.refusal}"
    before, after = np.degrees(c.found.before[3, 0]), np.degrees(c.found.after[3, 0])
    return (f"on the half not fitted, the angle by gravity differs from the encoder by {before:.2f} degrees rms, "
            f"{after:.2f} after calibration; published, by fusion with the gyro: below "
            f"{np.degrees(c.task.angle_below_rad):.0f}")


def _calibration_section(title: str, c: Calibrated) -> Section:
    about = [f"With {c.task.rig} on {', '.join(c.task.runs)}: {_calibration_words(c)}."]
    if c.found is None:
        return Section(f"{title}: IMU against encoder", about)
    lags = c.found.lags_s * 1e3
    notes = [f"The gyro's lag by blocks of {c.found.block_s:.1f} s: {lags.min():.1f} to {lags.max():.1f} ms; it "
             + ("wanders along the record." if c.found.lag_wanders else "does not wander.")]
    notes += [f"not determined: {name}" for name in open_terms(c.found)]
    return Section(f"{title}: IMU against encoder", about, [
        Table(["term", *FOUND], found_rows(c.found), {1, 2}, "found on the first half, 95 % intervals"),
        Table(["signal", *CHECK], check_rows(c.found), range(1, 5),
              "rms of IMU less encoder on the other half")], notes=notes)
