"""A study for people: text for a terminal, and the sections of its page."""

from __future__ import annotations

import numpy as np

from experiments.figures import BLUE, GREEN, GREY, ORANGE, Line, plot_lines
from experiments.output import text_table
from experiments.report import Picture, Section
from experiments.report import Table as PageTable
from experiments.study import FLOOR
from experiments.study_table import PAPER, Cell, Table

LABELS = {"mle": "MLE", "wls": "WLS-FCD", "rls": "RLS", "hekf": "HEKF", FLOOR: "floor"}
COLOURS = {"mle": ORANGE, "wls": BLUE, "rls": GREEN, "hekf": "#8e5cc4", FLOOR: GREY}
HEADER = ["case", "method", "mean", "paper", "variance", "paper", "failed", "paper", "median", "not converged"]
WHY = (
    "The paper does not print its controller, initial state or hold between samples. Here they are the walker of "
    "Grizzle, Abba and Plestan (2001) just after an impact of its periodic gait, torque held for 10 ms "
    "(experiments/walker.py). Errors therefore differ in size from the print even where a method is the same.",
    "The paper's 1.15 to 1.24 is the bias of finite differences: on this record without any noise, differences over "
    "2 samples leave a free-run error of 1.22 rad². MLE is a hundred times below it because its motion is one "
    "function whose derivatives are exact, under torque that acts as the hold says.",
    "Least squares compares a symmetric difference with the mean of the torques held before and after the sample; "
    "with the held torque of the sample itself its error in case 1 would be 45 rad² without any noise.",
    "WLS-FCD and RLS in cases 2 to 5 are worse than the print: torque and acceleration change fast just after the "
    "impact, and differences over 3 to 7 samples on both sides smear that. Many of their models have an inertia "
    "matrix that becomes singular on the way, which counts as a failed simulation.",
    "RLS weights the passive joint's equation heavily, as appendix A asks; errors in the angles then pull all "
    "parameters towards zero.",
    "HEKF knows the hold and is better than the print where the absolute angle is nearly exact; with more noise its "
    "linearisation fails as the paper reports.",
    "A simulation fails where the inertia matrix becomes singular on the way or a rate passes 10^4 rad/s, or where "
    "there is no fit; the paper does not say what it counted. Means and variances leave failed runs out.",
    "Case 5 has no filter in the paper and no row in Table III; it is filtered like case 4 here.",
)


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.4g}" if 1e-3 <= abs(value) < 1e5 or value == 0.0 else f"{value:.2e}"


def table_rows(table: Table) -> list[list[str]]:
    """Table III side by side with the print."""
    rows = []
    for case in table.cases:
        for method in table.methods:
            cell = table.cell(case.number, method)
            if cell is None:
                continue
            printed = PAPER.get(method, ())
            paper = [_number(v) for v in printed[case.number - 1]] if case.number <= len(printed) else ["-"] * 3
            rows.append([str(case.number), LABELS[method], _number(cell.mean), paper[0], _number(cell.variance),
                         paper[1], str(cell.failed), paper[2], _number(cell.median), str(cell.not_converged)])
    return rows


TRUST_HEADER = ["case", "method", "mean error / floor", "parameter MSE / bound", "worst parameter", "coverage of 95 %"]


def trust_rows(table: Table) -> list[list[str]]:
    """What the estimates are worth against what is possible."""
    rows = []
    for case in table.cases:
        floor = table.cell(case.number, FLOOR)
        for method in table.methods:
            cell = table.cell(case.number, method)
            if cell is None or method == FLOOR:
                continue
            ratio = _number(cell.mean / floor.mean) if floor is not None else "-"
            rows.append([str(case.number), LABELS[method], ratio, _number(cell.mse_over_bound),
                         _number(cell.worst_over_bound), f"{100.0 * cell.coverage:.1f} %"])
    return rows


def study_text(table: Table, wall_s: float) -> str:
    """What a person reads after `legid monte-carlo`."""
    right = set(range(2, len(HEADER)))
    spent = sum(cell.seconds for cell in table.cells)
    return "\n".join([
        f"biped3, {table.runs} runs a case, seed {table.seed}: {wall_s:.0f} s now, {spent:.0f} s of computing in all",
        "summed squared angle error of the free run [rad^2], beside Table III of the paper", "",
        text_table(HEADER, table_rows(table), right), "",
        text_table(TRUST_HEADER, trust_rows(table), set(range(2, len(TRUST_HEADER))))])


def study_summary(table: Table) -> str:
    """One sentence at the top of the page."""
    ahead = [case.number for case in table.cases if _leads(table, case.number)]
    return (f"{table.runs} simulated steps of the three-link walker a case, seed {table.seed}. MLE has the lowest "
            f"mean error in case{'s' if len(ahead) != 1 else ''} {', '.join(map(str, ahead)) or 'none'} of "
            f"{', '.join(str(case.number) for case in table.cases)}.")


def _leads(table: Table, case: int) -> bool:
    mle = table.cell(case, "mle")
    others = [c for c in table.cells if c.case == case and c.method not in ("mle", FLOOR)]
    return mle is not None and all(mle.mean < other.mean for other in others if np.isfinite(other.mean))


def study_sections(table: Table) -> list[Section]:
    """Everything the page shows."""
    noise = ", ".join(f"{case.number}: {case.angle_variance:g} rad²" for case in table.cases)
    return [
        Section("Table III",
                ["Sample mean and variance of the summed squared angle error of the identified model, simulated from "
                 "the true state under the true torque for 0.68 s, beside the paper's print.",
                 f"Variance of the absolute angle by case: {noise}. Torque variance 0.1 N²m², relative angles free of "
                 "noise, 100 Hz. Floor: least squares on the true states, so that only torque noise is left."],
                [PageTable(HEADER, table_rows(table), right=frozenset(range(2, len(HEADER))))]),
        Section("What the numbers are worth",
                ["The Cramér-Rao bound is that of the model as posed: exact motion of a rigid walker under held "
                 "torque, states and true torques unknown. Parameter errors are measured in the bound's own metric, "
                 "averaged over all directions, and for the single worst parameter. Least squares methods do not "
                 "account for errors in the angles, so their intervals do not cover."],
                [PageTable(TRUST_HEADER, trust_rows(table), right=frozenset(range(2, len(TRUST_HEADER))))]),
        Section("Distribution of the errors",
                ["Share of all runs whose error is below the value on the axis; a curve that ends below 1 has failed "
                 "runs."], pictures=[_distribution(table, case.number) for case in table.cases]),
        Section("Where numbers differ from the print, and why", notes=list(WHY)),
    ]


def _distribution(table: Table, case: int) -> Picture:
    curves = {m: table.errors[case, m] for m in table.methods if (case, m) in table.errors}
    finite = np.concatenate([e[np.isfinite(e) & (e > 0.0)] for e in curves.values()])
    low, high = (np.log10(finite.min()), np.log10(finite.max())) if finite.size else (-3.0, 3.0)
    grid = np.linspace(low, max(high, low + 1.0), 300)
    lines = []
    for method, error in curves.items():
        below = np.searchsorted(np.sort(error[np.isfinite(error)]), 10.0**grid, side="right") / error.size
        lines.append(Line(LABELS[method], below, COLOURS[method], dashed=method == FLOOR))
    cell: Cell | None = table.cell(case, "mle")
    caption = f"Case {case}." + (f" MLE: median {_number(cell.median)} rad², mean {_number(cell.mean)} rad²."
                                 if cell is not None else "")
    return Picture(plot_lines(grid, lines, f"share of runs, case {case}", "log10 of the error [rad²]"), caption)
