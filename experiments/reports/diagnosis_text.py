"""A diagnosis for a terminal, and the words that its report shares."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite, isinf

from estimator.diagnosis import CandidateScore, Cause, Diagnosis, SensorGain, ShortRuns
from experiments.console import text_table
from experiments.documents import contract_joint, split_key
from experiments.judge import Files, next_step, normal, number, with_names
from experiments.reports.diagnosis_json import untestable
from experiments.reports.structure import HEADER as STRUCTURE_HEADER
from experiments.reports.structure import USE, structure_rows, structure_words

RUNNERS_UP = 5
CANDIDATE_HEADER = ["effect", "score", "p", "size", "smallest detectable", "unit"]


def effect_label(effect: str, joint: int | None) -> str:
    """`stribeck_friction, joint 2`."""
    joint = contract_joint(effect, joint)
    return effect if joint is None else f"{effect}, joint {joint}"


def key_label(key: str) -> str:
    """The same from the estimator's key; a generic term keeps its own words."""
    return effect_label(*split_key(key)) if key.partition("@")[2].isdecimal() else key


def probability(p: float) -> str:
    """A p-value as far as it can be believed."""
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"


def gain_text(gain: float) -> str:
    """A gain in log likelihood to three digits, without an exponent."""
    return f"{gain:.3g}" if gain < 999.5 else f"{gain:.0f}"


def size_rows(cause: Cause) -> list[list[str]]:
    """effect, size, value, interval, unit; the name only in the first row."""
    rows = []
    for k, s in enumerate(cause.size):
        rows.append(["" if k else effect_label(cause.effect, cause.joint), s.name, f"{s.value:.4g}",
                     f"{s.ci95[0]:.4g} .. {s.ci95[1]:.4g}", s.unit])
    return rows


def size_text(candidate: CandidateScore) -> str:
    """Its one-step size; nothing where the nominal parameters imitate it."""
    return "" if isinf(candidate.smallest_detectable) else f"{candidate.size:.3g}"


def detectable_text(candidate: CandidateScore) -> str:
    """The smallest size that these runs would have shown."""
    return "none" if isinf(candidate.smallest_detectable) else f"{candidate.smallest_detectable:.2g}"


def candidate_row(candidate: CandidateScore) -> list[str]:
    """One row of CANDIDATE_HEADER."""
    return [effect_label(candidate.effect, candidate.joint), f"{candidate.score:.1f}", probability(candidate.p_value),
            size_text(candidate), detectable_text(candidate), candidate.unit]


def answer_words(found: Diagnosis) -> str:
    """The probability of the answer, and the same with its condition; empty where none is stated."""
    if found.probability is None or found.in_library is None:
        return ""
    alone = "above 0.99" if found.in_library > 0.99 else f"{found.in_library:.2f}"
    return (f"Probability of this answer: {found.probability:.2f}, as on simulated legs; {alone} if the library has "
            "the true causes.")


def hold_words(found: Diagnosis) -> str:
    """Sentence on how torque was taken to act between samples; empty where nothing was fitted."""
    return f"Torque acts between samples by the '{found.hold}' hold." if found.hold else ""


SMALL_HEADER, WORTH = ["effect", "size", "value", "tolerance (1 sigma)", "unit"], 0.5
"""Of a tolerance: smaller sizes are not in the table."""
SMALL_TITLE = "Within the rig's tolerances, taken off the readings before anything was tried"


def small_rows(found: Diagnosis) -> list[list[str]]:
    """One row of SMALL_HEADER for each size that is worth a line."""
    return [[effect_label(one.effect, one.joint), one.name, f"{one.value:.3g}", f"{one.tolerance:.3g}", one.unit]
            for one in found.within_tolerance if abs(one.value) >= WORTH * one.tolerance]


ERROR_HEADER = ["sensor", "nominal", "extended", "noise alone"]


def error_rows(sensors: Mapping[str, SensorGain]) -> list[list[str]]:
    """One row of ERROR_HEADER a sensor."""
    return [[column, f"{g.before:.4g}" if isfinite(g.before) else "diverged", f"{g.after:.4g}", f"{g.floor:.4g}"]
            for column, g in sensors.items()]


def gap_text(found: Diagnosis) -> str:
    """The share of the gap that free runs of whole runs show closed; empty where there is none."""
    return share_text(found.sensors, found.gap_closed, found.gap_closed_ci95)


def share_text(sensors: Mapping[str, SensorGain], closed: float | None, ci95: tuple[float, float] | None) -> str:
    """The share of the rms errors' gap that is closed, with its interval; empty where there is none.

    `closed` is the documents' share of mean squares; under rms figures stands what it is of these.
    """
    before = _over_noise(sensors)
    if closed is None or not before > 1.0:
        return ""
    if isinf(before):
        return (f"The nominal simulation diverges. With errors of at most the sensor's spread the extension closes "
                f"{100 * closed:.0f} % of the gap in mean square to noise alone.")
    after = _left(closed, before)
    interval = ""
    if ci95 is not None:
        low, high = ((before - _left(c, before)) / (before - 1.0) for c in ci95)
        interval = f" (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    return (f"The extension closes {100 * (before - after) / (before - 1.0):.0f} % of the gap between the nominal rms "
            f"error and that of noise alone{interval}: over all sensors from {before:.3g} to {after:.2g} times noise "
            "alone.")


def _over_noise(sensors: Mapping[str, SensorGain]) -> float:
    """rms over the sensors of the nominal error in multiples of what noise alone leaves."""
    shares = [(g.before / g.floor) ** 2 for g in sensors.values() if g.floor > 0.0]
    return (sum(shares) / len(shares)) ** 0.5 if shares else 0.0


def _left(closed: float, before: float) -> float:
    """rms error in those multiples, of which the share `closed` of the mean squares' gap is taken away."""
    return float(max(before**2 - closed * (before**2 - 1.0), 0.0) ** 0.5)


def short_title(short: ShortRuns) -> str:
    """Title of the errors over pieces."""
    return f"rms errors over pieces of {short.horizon_s:g} s, in which noise adds up to less"


BUDGET_HEADER = ["part of the simulation's error", "share", "95 % interval"]


def budget_words(found: Diagnosis) -> str:
    """Meaning of the budget's shares, and the reduction of the error."""
    where = "all runs, each held out once" if found.rotations else "the held-out runs"
    words = f"Contributions to the mean squared free-run error of the nominal model, on {where}"
    if found.error is None:
        return f"{words}:"
    return (f"{words} (rms error {found.error[0]:.2f} times that of noise alone, {found.error[1]:.2f} with the causes "
            "found):")


ROTATION_HEADER = ["held-out runs", "size, fitted to the others", "value", "error falls"]


def rotation_words(found: Diagnosis) -> str:
    """Why the split was rotated, and in how many rotations the error falls."""
    return (f"The held-out runs do not show whether the error falls by {100 * found.material:.0f} %. So the split was "
            f"rotated until every run was held out once. The error falls in {sum(r.falls for r in found.rotations)} of "
            f"{len(found.rotations)} rotations.")


def rotation_rows(found: Diagnosis) -> list[list[str]]:
    """One row of ROTATION_HEADER a size and turn."""
    return [[", ".join(turn.runs), f"{key_label(name.rpartition('.')[0])}: {name.rpartition('.')[2]}", f"{value:.4g}",
             "yes" if turn.falls else "no"] for turn in found.rotations for name, value in turn.sizes.items()]


def budget_rows(found: Diagnosis) -> list[list[str]]:
    """One row of BUDGET_HEADER for each part of the nominal model's error; together they are all of it."""
    names = {"remainder": "residual", "noise": "noise alone"}
    return [[names.get(row.what) or effect_label(row.effect or "", row.joint), f"{100 * row.of_error:.1f} %",
             f"{100 * row.of_error_ci95[0]:.1f} to {100 * row.of_error_ci95[1]:.1f} %"]
            for row in found.budget if row.what != "nominal"]


def causes_title(found: Diagnosis) -> str:
    """Title of the list of causes; without any there are only warnings."""
    if not found.causes:
        return "Small faults and warnings" if small_rows(found) else "Warnings"
    return {"one_of": "One of these", "unexplained": "The closest, not sufficient"}.get(found.verdict, "Causes")


PARAMETERS = "The nominal parameters absorb part of the missing effects. These shifts are their bias."


def parameter_rows(found: Diagnosis) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the nominal parameters and, where a cause was found, the corrected ones."""
    rows = []
    for name, value in found.nominal.items():
        std = found.nominal_std.get(name, inf)
        row = [name, number(value, std), normal(value, std).interval]
        if name in found.extended:
            new, new_std = found.extended[name], found.extended_std.get(name, inf)
            row += [number(new, new_std), normal(new, new_std).interval,
                    f"{(new - value) / std:+.1f}" if 0.0 < std < inf else ""]
        rows.append(row)
    if found.extended:
        return ["parameter", "nominal", "95 % interval", "corrected", "95 % interval", "shift / std"], rows
    if any(row[2] for row in rows):
        return ["parameter", "nominal", "95 % interval"], rows
    return ["parameter", "nominal"], [row[:2] for row in rows]


def causes_text(found: Diagnosis) -> str:
    """The causes with their sizes, under their title."""
    rows = [row for cause in found.causes for row in size_rows(cause)]
    return f"{causes_title(found)}:\n" + text_table(["effect", "size", "value", "95 % interval", "unit"], rows, {2, 3})


def errors_on_held_out(found: Diagnosis) -> str:
    """The free-run errors on the held-out runs."""
    return (f"Free-run error (rms) on the held-out runs {', '.join(found.confirm_runs)}:\n"
            + text_table(ERROR_HEADER, error_rows(found.sensors), {1, 2, 3}))


def short_diagnosis_text(found: Diagnosis) -> str:
    """The verdict, the causes and the errors."""
    return "\n\n".join([found.sentence, *([causes_text(found)] if found.causes else []),
                        *([errors_on_held_out(found)] if found.sensors else [])])


def diagnosis_text(found: Diagnosis, files: Files | None = None) -> str:
    """Text after `legid diagnose`: the verdict first. The next step names `files`."""
    blocks = ["\n".join(filter(None, [found.sentence, answer_words(found)]))]
    if found.structure is not None:
        blocks.append("\n".join([structure_words(found.structure), text_table(
            STRUCTURE_HEADER, structure_rows(found.structure), {2, 3}), USE]))
    if found.budget:
        blocks.append(f"{budget_words(found)}\n" + text_table(BUDGET_HEADER, budget_rows(found), {1, 2}))
        if found.rotations:
            blocks.append(f"{rotation_words(found)}\n" + text_table(ROTATION_HEADER, rotation_rows(found), {2}))
    if found.causes:
        blocks.append(causes_text(found))
    if found.causes and found.extended:
        header, rows = parameter_rows(found)
        blocks.append(f"{PARAMETERS}\n" + text_table(header, rows, {1, 2, 3, 4, 5}))
    if found.immaterial:
        rows = [row for cause in found.immaterial for row in size_rows(cause)]
        blocks.append("Present, not material:\n" + text_table(
            ["effect", "size", "value", "95 % interval", "unit"], rows, {2, 3}))
    if rows := small_rows(found):
        blocks.append(f"{SMALL_TITLE}:\n" + text_table(SMALL_HEADER, rows, {2, 3}))
    if found.sensors:
        blocks.append(f"{errors_on_held_out(found)}\n{gap_text(found)}".rstrip())
    if found.short is not None:
        blocks.append("\n".join([
            f"The same runs, {short_title(found.short)}:",
            text_table(ERROR_HEADER, error_rows(found.short.sensors), {1, 2, 3}),
            share_text(found.short.sensors, found.short.closed, found.short.ci95)]).rstrip())
    if found.candidates:
        blocks.append(_candidates(found))
    if found.not_testable:
        blocks.append("Cannot be tested here:\n" + "\n".join(
            f"  {effect_label(effect, joint)}: {why}" for effect, joint, why in untestable(found)))
    blocks += [f"warning: {text}" for text in found.warnings]
    if found.next_experiment:
        blocks.append(f"Next experiment: {found.next_experiment}")
    blocks.append(f"Next step: {with_names(next_step(found), files)}")
    used = "; ".join(f"{group} {', '.join(names)}" for group, names in found.runs.items() if names)
    blocks.append(" ".join(filter(None, [f"Runs: {used}." * bool(used), hold_words(found), f"({found.wall_s:.0f} s)"])))
    return "\n\n".join(blocks)


def _candidates(found: Diagnosis) -> str:
    chosen = {(cause.effect, cause.joint) for cause in found.causes}
    others = [c for c in found.candidates if (c.effect, c.joint) not in chosen][:RUNNERS_UP]
    title = "Next best effects, scored individually:" if chosen else "Best effects of the library, scored individually:"
    return f"{title}\n" + text_table(CANDIDATE_HEADER, [candidate_row(c) for c in others], {1, 2, 3, 4})
