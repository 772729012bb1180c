"""A diagnosis for a terminal, and the tables and words that its page shares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import inf, isfinite, isinf

from msgspec.structs import asdict

from estimator.diagnosis import SensorGain
from experiments.documents import (
    DiagnosisDocument,
    NamedCause,
    NotTestable,
    Number,
    Scored,
    Untestable,
    contract_joint,
    finite,
    split_key,
)
from experiments.judge import Files, normal, number, with_names
from experiments.reports.html import Section, Table
from experiments.reports.structure import USE, structure_table, structure_words

RUNNERS_UP = 5
PARAMETERS = "The nominal parameters absorb part of the missing effects. These shifts are their bias."


def effect_label(effect: str, joint: int | None) -> str:
    """`stribeck_friction, joint 2`."""
    return effect if joint is None else f"{effect}, joint {joint}"


def key_label(key: str) -> str:
    """The same from the estimator's key; a generic term keeps its own words."""
    effect, joint = split_key(key) if key.partition("@")[2].isdecimal() else (key, None)
    return effect_label(effect, contract_joint(effect, joint))


def probability(p: float) -> str:
    """A p-value as far as it can be believed."""
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"


def size_table(causes: Iterable[NamedCause], caption: str = "") -> Table:
    """One row a size; the effect stands in its first row alone."""
    return Table(["effect", "size", "value", "95 % interval", "unit"], [
        ["" if k else effect_label(cause.effect, cause.joint), s.name, f"{s.value:.4g}",
         f"{finite(s.ci95[0]):.4g} .. {finite(s.ci95[1]):.4g}", s.unit]
        for cause in causes for k, s in enumerate(cause.size)], {2, 3}, caption)


def size_text(candidate: Scored) -> str:
    """Its one-step size; nothing where the nominal parameters imitate it."""
    return "" if candidate.smallest_detectable is None else f"{finite(candidate.size):.3g}"


def detectable_text(candidate: Scored) -> str:
    """The smallest size that these runs would have shown."""
    return "none" if candidate.smallest_detectable is None else f"{candidate.smallest_detectable:.2g}"


def untestable_section(found: Sequence[NotTestable | Untestable]) -> Section:
    """Effects that the runs cannot show; empty without any."""
    return Section("What cannot be tested here", (), [Table(["effect", "why"], [
        [effect_label(one.effect, one.joint), one.why] for one in found])] if found else ())


def candidate_label(candidate: Scored) -> str:
    """Effect and joint of a candidate; of a rotor that of its motor where there are several."""
    return effect_label(candidate.effect, candidate.motor or candidate.joint)


def hold_words(document: DiagnosisDocument) -> str:
    """Sentence on how torque was taken to act between samples; empty where nothing was fitted."""
    return f"Torque acts between samples by the '{document.hold}' hold." if document.hold else ""


def error_table(sensors: Mapping[str, SensorGain], caption: str = "") -> Table:
    """One row a sensor."""
    return Table(["sensor", "nominal", "extended", "noise alone"], [
        [column, f"{g.before:.4g}" if isfinite(g.before) else "diverged", f"{g.after:.4g}", f"{g.floor:.4g}"]
        for column, g in sensors.items()], {1, 2, 3}, caption)


def gap_text(document: DiagnosisDocument) -> str:
    """The share of the gap that is closed over whole runs, and the ratio of errors by horizon; empty without both."""
    told = ", ".join(f"{finite(one.ratio):.2g} [{', '.join(f'{finite(end):.2g}' for end in one.ci95)}] over "
                     f"{f'{one.horizon_s:g} s' if one.horizon_s else 'whole runs'}"
                     for one in document.gain.by_horizon or ())
    return " ".join(filter(None, [share_text(document.sensors, document.gap_closed, document.gain.gap_closed_ci95),
                                  told and f"Error of the extended model over that of the nominal one: {told}."]))


def share_text(sensors: Mapping[str, SensorGain], closed: Number, ci95: tuple[Number, Number] | None) -> str:
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
        low, high = ((before - _left(finite(c), before)) / (before - 1.0) for c in ci95)
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


def budget_words(document: DiagnosisDocument) -> str:
    """Meaning of the budget's shares, and the reduction of the error."""
    where = "all runs, each held out once" if document.rotations else "the held-out runs"
    words = f"Contributions to the mean squared free-run error of the nominal model, on {where}"
    if document.error is None:
        return f"{words}:"
    before, after = (inf if error is None else error for error in (document.error.before, document.error.after))
    return f"{words} (rms error {before:.2f} times that of noise alone, {after:.2f} with the causes found):"


def budget_table(document: DiagnosisDocument) -> Table:
    """One row for each part of the nominal model's error; together they are all of it."""
    names = {"remainder": "residual", "noise": "noise alone"}
    return Table(["part of the simulation's error", "share", "95 % interval"], [
        [names.get(row.what) or effect_label(row.effect or "", row.joint), f"{100 * finite(row.of_error):.1f} %",
         "{:.1f} to {:.1f} %".format(*(100 * finite(x) for x in row.of_error_ci95))]
        for row in document.budget if row.what != "nominal"], {1, 2})


def rotation_words(found: DiagnosisDocument) -> str:
    """Why the split was rotated, and in how many rotations the error falls."""
    return (f"The held-out runs do not show whether the error falls by {100 * found.material:.0f} %. So the split was "
            f"rotated until every run was held out once. The error falls in {sum(r.falls for r in found.rotations)} of "
            f"{len(found.rotations)} rotations.")


def rotation_table(found: DiagnosisDocument) -> Table:
    """One row a size and turn."""
    return Table(["held-out runs", "size, fitted to the others", "value", "error falls"], [
        [", ".join(turn.confirm_runs), f"{key_label(key)}: {size}", f"{finite(value):.4g}",
         "yes" if turn.falls else "no"]
        for turn in found.rotations for name, value in turn.sizes.items() for key, _, size in [name.rpartition(".")]],
        {2}, "every run held out once")


def causes_title(document: DiagnosisDocument) -> str:
    """Title of the list of causes."""
    return {"one_of": "One of these", "unexplained": "The closest, not sufficient"}.get(document.verdict, "Causes")


def parameter_table(document: DiagnosisDocument) -> Table:
    """The nominal parameters and, where a cause was found, the corrected ones."""
    rows, given = [], document.parameters
    for name, value in given.nominal.items():
        one = normal(finite(value), _std(given.nominal_std.get(name)))
        row = [name, number(one.value, one.std), one.interval]
        if name in given.extended:
            new = normal(finite(given.extended[name]), _std(given.extended_std.get(name)))
            row += [number(new.value, new.std), new.interval,
                    f"{(new.value - one.value) / one.std:+.1f}" if 0.0 < one.std < inf else ""]
        rows.append(row)
    if given.extended:
        return Table(["parameter", "nominal", "95 % interval", "corrected", "95 % interval", "shift / std"], rows,
                     range(1, 6))
    if any(row[2] for row in rows):
        return Table(["parameter", "nominal", "95 % interval"], rows, {1, 2})
    return Table(["parameter", "nominal"], [row[:2] for row in rows], {1})


def _std(value: Number) -> float:
    return inf if value is None else value


def causes_text(document: DiagnosisDocument) -> str:
    """The causes with their sizes, under their title."""
    return _titled(f"{causes_title(document)}:", size_table(document.causes))


def errors_on_held_out(document: DiagnosisDocument) -> str:
    """The free-run errors on the held-out runs."""
    return _titled(f"Free-run error (rms) on the held-out runs {', '.join(document.confirm_runs)}:",
                   error_table(document.sensors))


def _titled(title: str, table: Table, *after: str) -> str:
    """A table under its title, with sentences below; empty without rows."""
    return "\n".join([title, table.text, *filter(None, after)]) if table.rows else ""


def short_diagnosis_text(found: DiagnosisDocument) -> str:
    """The answer, the causes and the errors."""
    return "\n\n".join(filter(None, [found.headline.text, causes_text(found), errors_on_held_out(found)]))


def diagnosis_text(document: DiagnosisDocument, files: Files | None = None) -> str:
    """Text after `legid diagnose`: the verdict first. The next step names `files`."""
    used = "; ".join(f"{group} {', '.join(names)}" for group, names in asdict(document.runs).items() if names)
    blocks = [
        with_names(document.headline.text, files),
        _titled(structure_words(document.structure), structure_table(document.structure, document.force_unit), USE)
        if document.structure else "",
        _titled(budget_words(document), budget_table(document)),
        _titled(rotation_words(document), rotation_table(document)) if document.budget and document.rotations else "",
        causes_text(document),
        _titled(PARAMETERS, parameter_table(document)) if document.parameters.extended else "",
        _titled("Present, not material:", size_table(document.immaterial)),
        "\n".join(filter(None, [errors_on_held_out(document), gap_text(document)])),
        _candidates(document),
        "\n".join(["Cannot be tested here:", *(f"  {effect_label(one.effect, one.joint)}: {one.why}"
                                               for one in document.not_testable)]) if document.not_testable else "",
        f"Next experiment: {document.next_experiment}" if document.next_experiment else "",
        " ".join(filter(None, [f"Runs: {used}." * bool(used), hold_words(document), f"({document.wall_s:.0f} s)"]))]
    return "\n\n".join(filter(None, blocks))


def _candidates(document: DiagnosisDocument) -> str:
    chosen = {(cause.effect, cause.joint) for cause in document.causes}
    rows = [[candidate_label(c), f"{c.score:.1f}", probability(c.p_value), size_text(c), detectable_text(c), c.unit]
            for c in document.candidates if (c.effect, c.joint) not in chosen][:RUNNERS_UP]
    return _titled("Next best effects, scored individually:" if chosen else
                   "Best effects of the library, scored individually:",
                   Table(["effect", "score", "p", "size", "smallest detectable", "unit"], rows, {1, 2, 3, 4}))
