"""A study for people: text for a terminal, and the sections of its page."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from estimator import METHODS
from experiments.console import text_table
from experiments.provenance import program_version
from experiments.reports import BLUE, GREEN, GREY, ORANGE, Line, Picture, Section, plot_lines
from experiments.reports import Table as PageTable
from studies.biped3.claims import claims
from studies.biped3.protocol import OURS
from studies.biped3.reasons import reasons
from studies.biped3.study import BLOCK, FLOOR, KNOWN_WLS, PAPERS_MLE, Case, truth
from studies.biped3.table import LABELS, PAPER, Cell, Table
from studies.walker import motor_mechanism

COLOURS = {"mle": ORANGE, PAPERS_MLE: "#b5485d", "wls": BLUE, KNOWN_WLS: "#6aa5d8",
           "rls": GREEN, "hekf": "#8e5cc4", FLOOR: GREY}
HEADER = ["method", "mean", "excess", "mean, paper", "variance", "variance, paper", "failed", "failed, paper", "median",
          "not converged"]
TRUST_HEADER = ["case, method", "mean error / floor", "MSE / bound, mean", "MSE / bound, worst", "coverage of 95 %"]


def figure(value: float) -> str:
    """Three digits; powers of ten for the very large and small, a dash for what is not there."""
    if not np.isfinite(value):
        return "-"
    if 1e-3 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    return f"{value:.0f}" if value == 0.0 or 999.5 <= abs(value) < 1e4 else short(f"{value:.2e}")


def short(text: str) -> str:
    """1.0e+07 as 1e7."""
    mantissa, _, exponent = text.partition("e")
    return f"{float(mantissa):g}e{int(exponent)}" if exponent else text


def as_printed(value: float) -> str:
    """All digits of a figure of the paper."""
    return f"{value:.7g}" if abs(value) < 1e4 else short(f"{value:.6e}")


def table_rows(table: Table, case: Case) -> list[list[str]]:
    """One case of Table III side by side with the paper's."""
    rows = []
    for method in table.methods:
        cell = table.cell(case.number, method)
        if cell is None:
            continue
        printed = PAPER.get(method, ())[case.number - 1 : case.number]
        paper = [as_printed(v) for row in printed for v in row] or ["-"] * 3
        rows.append([LABELS[method], figure(cell.mean), figure(cell.mean - table.true_error), paper[0],
                     figure(cell.variance), paper[1], str(cell.failed), paper[2], figure(cell.median),
                     str(cell.not_converged)])
    return rows


def trust_rows(table: Table) -> list[list[str]]:
    """Estimates against the bound."""
    rows = []
    for case in table.cases:
        floor = table.cell(case.number, FLOOR)
        for method in table.methods:
            cell = table.cell(case.number, method)
            if cell is None or method == FLOOR:
                continue
            ratio = figure(cell.mean / floor.mean) if floor is not None else "-"
            rows.append([f"{case.number}, {LABELS[method]}", ratio, figure(cell.mean_mse_over_bound),
                         figure(max(cell.mse_over_bound)), f"{100.0 * cell.coverage:.1f} %"])
    return rows


def study_text(table: Table, wall_s: float) -> str:
    """Text after `legid monte-carlo`."""
    lines = [f"biped3, protocol {table.protocol.name}, {table.runs} runs a case, seed {table.seed}: "
             f"{wall_s:.0f} s now, {table.seconds:.0f} s of processor time in all",
             "summed squared angle error of the free run [rad^2], next to Table III of the paper; excess: above the "
             f"{figure(table.true_error)} that true parameters leave", ""]
    rows = [[str(case.number), *row] for case in table.cases for row in table_rows(table, case)]
    lines += [text_table(["case", *HEADER], rows, set(range(2, len(HEADER) + 1))), "",
              text_table(TRUST_HEADER, trust_rows(table), set(range(1, len(TRUST_HEADER)))), ""]
    found = claims(table) if table.protocol == OURS else []
    lines += [f"{'met' if claim.met else 'NOT MET'}: {claim.demand}: {claim.measured}" for claim in found]
    return "\n".join([*lines, _uncertainty(table)])


def _uncertainty(table: Table) -> str:
    """How far chance alone moves the ratios, from the variance of a mean of squared normal errors and of a share."""
    ratio, share = np.sqrt(2.0 / table.runs), np.sqrt(0.05 * 0.95 / table.runs)
    return (f"With {table.runs} runs chance alone moves a parameter's ratio to its bound by {100.0 * ratio:.0f} % and "
            f"its coverage by {100.0 * share:.1f} points (1 sigma).")


def study_summary(table: Table) -> str:
    """The page's first sentences."""
    found = claims(table) if table.protocol == OURS else []
    missed = [claim.demand for claim in found if not claim.met]
    verdict = "All that was demanded is met." if not missed else f"Not met: {'; '.join(missed)}."
    cases, methods = len(table.cases), len([m for m in table.methods if m != FLOOR])
    return (f"{table.runs} noisy records of one step of the three-link walker in {_each(cases, 'case')}, "
            f"identified by {_each(methods, 'method')}; seed {table.seed}, protocol "
            f"{table.protocol.name} (true parameters leave {figure(table.true_error)} rad²). "
            + (verdict if found else ""))


def _each(count: int, what: str) -> str:
    return f"one {what}" if count == 1 else f"each of {count} {what}s"


def study_sections(table: Table, machine: str, note: str = "") -> list[Section]:
    """Everything the page shows; `note` is a sentence of whoever ran the study."""
    sections = []
    if found := claims(table) if table.protocol == OURS else []:
        rows = [[claim.demand, claim.measured, "yes" if claim.met else "NO"] for claim in found]
        sections.append(Section(
            "Demanded and measured",
            ["Where several values stand in one row, they are in the order of the cases. " + _uncertainty(table)],
            [PageTable(["demanded", "measured", "met"], rows)]))
    sections += [_table_iii(table), _trust(table)]
    if any(cell.method == "mle" for cell in table.cells):
        sections.append(_parameters(table))
    sections += [
        Section("Distribution of the errors",
                ["Share of all runs whose error is below the value on the axis; a curve that ends below 1 has failed "
                 "runs."], pictures=[_distribution(table, case.number) for case in table.cases]),
        *([Section("Where numbers differ from the paper, and why", notes=reasons(table))]
          if table.protocol == OURS else []),
        _making(table, machine, note)]
    return sections


def _table_iii(table: Table) -> Section:
    right = range(1, len(HEADER))
    return Section(
        "Table III",
        ["Sample mean and variance of the summed squared angle error [rad²] of the identified model, next to the "
         "paper's. Each is simulated for 0.68 s from the true state under the true torque. Variance of both torques "
         "0.1 N²m², relative angles free of noise, 100 Hz.",
         "Floor: the same records with the true states given to least squares (rows weighted alike), so that only "
         "torque noise is left. "
         "Failed: no fit, or a simulation that did not reach its end; failed runs are left out of mean, variance and "
         "median."],
        [PageTable(HEADER, table_rows(table, case), right=right,
                   caption=f"Case {case.number}: variance of the absolute angle {figure(case.angle_variance)} rad²")
         for case in table.cases])


def _trust(table: Table) -> Section:
    return Section(
        "What the numbers are worth",
        ["Mean squared error of each parameter over its Cramér-Rao bound: the mean of the eight parameters, and the "
         "worst one. The bound is that of the model as posed: exact motion of a rigid walker under held torque, states "
         "and true torques unknown. Least squares takes the angles as exact, so its intervals do not cover."],
        [PageTable(TRUST_HEADER, trust_rows(table), range(1, len(TRUST_HEADER)))])


def _parameters(table: Table) -> Section:
    cells = [cell for cell in table.cells if cell.method == "mle"]
    header = ["", *(f"case {cell.case}" for cell in cells)]
    right = range(1, len(header))
    names = motor_mechanism().names
    ratios = [[f"{name} = {value:g}", *(f"{cell.mse_over_bound[k]:.3f}" for cell in cells)]
              for k, (name, value) in enumerate(zip(names, truth()))]
    coverage = [[name, *(f"{100.0 * cell.coverage_by_parameter[k]:.1f} %" for cell in cells)]
                for k, name in enumerate(names)]
    joint = [["likelihood ratio, mean (8 is ideal)", *(f"{cell.likelihood_ratio:.2f}" for cell in cells)],
             ["truth inside the joint 95 % region", *(f"{100.0 * cell.joint_coverage:.1f} %" for cell in cells)],
             ["false minima", *(str(cell.false_minima) for cell in cells)],
             ["MSE / bound over all directions", *(figure(cell.mse_over_bound_all_directions) for cell in cells)]]
    return Section(
        "MLE, parameter by parameter",
        ["The likelihood ratio compares how well estimate and truth explain the same record; it does not depend on how "
         "the model is parametrised. Below zero, the search would have ended in a false minimum. In case 1 it is below "
         "8 and the joint region too wide because the fit allows the stance foot 0.03 N m that it does not carry; the "
         "estimates do not hinge on that."],
        [PageTable(header, ratios, right, "Mean squared error over the Cramér-Rao bound"),
         PageTable(header, coverage, right, "Share of runs whose 95 % interval holds the truth"),
         PageTable(header, joint, right, "All parameters together")])


def _making(table: Table, machine: str, note: str) -> Section:
    by_method = [[LABELS[method], figure(sum(c.seconds for c in table.cells if c.method == method))]
                 for method in table.methods]
    methods = [m for m in table.methods if m != FLOOR]
    options = "" if methods == [m for m in methods if m in METHODS] and len(methods) == len(METHODS) else (
        f" --methods {','.join(methods)}")
    options += "" if table.protocol == OURS else f" --protocol {table.protocol.name}"
    cases = [case.number for case in table.cases]
    options += "" if len(cases) == 5 else f" --cases {','.join(map(str, cases))}"
    return Section(
        "How it was made",
        [f"legid monte-carlo biped3 --runs {table.runs} --seed {table.seed}{options} (legid {program_version()}, "
         f"{datetime.now(UTC):%Y-%m-%d})",
         f"Machine that gathered the results: {machine}. Processor time of all work, whichever worker did it: "
         f"{table.seconds:.0f} s. Noise of a run depends on the seed, the case and the run's number alone; work is cut "
         f"into blocks of {BLOCK} runs.", *([note] if note else [])],
        [PageTable(["method", "processor time [s]"], by_method, {1})])


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
    caption = f"Case {case}." + (f" MLE: median {figure(cell.median)} rad², mean {figure(cell.mean)} rad²."
                                 if cell is not None else "")
    return Picture(plot_lines(grid, lines, f"share of runs, case {case}", "log10 of the error [rad²]"), caption)
