"""`make replication`: Table III under the protocol that the paper is nearest to, and what open choices do to it."""

from dataclasses import replace

import numpy as np

from evidence.frame import Lines, program, table, tell
from evidence.kept import kept
from evidence.registry import Evidence
from studies.biped3 import CASES
from studies.biped3.protocol import OURS, PRINTED, Protocol
from studies.biped3.report import figure
from studies.biped3.study import BLOCK, KNOWN_WLS, PAPERS_MLE, Block, BlockResult, error_of_truth, run_block
from studies.biped3.table import LABELS, PAPER

REGULAR = CASES[:4]
CLOSE = 0.25
"""A mean within this share of the paper counts as reproduced."""
SEED = 5
FEW = 40
"""Runs for each open choice."""
PAPERS = {"MLE": ("mle", PAPERS_MLE), "WLS-FCD": ("wls", KNOWN_WLS), "HEKF": ("hekf",), "RLS": ("rls",)}
"""Row of the paper -> our methods"""
METHODS = [method for methods in PAPERS.values() for method in methods]
BY_OURS, BY_PAPERS = ("mle", "wls", "rls"), (PAPERS_MLE, "wls", "rls")
CHOICES: tuple[tuple[str, Protocol, tuple[str, ...]], ...] = (
    ("as printed below", PRINTED, (PAPERS_MLE, "wls", KNOWN_WLS, "rls")),
    *((f"bandwidth {rate:g} rad/s", replace(PRINTED, bandwidth=rate), BY_OURS) for rate in (4.0, 5.0, 8.0)),
    ("controller sampled, torque held, fits told so (our protocol)", OURS, BY_OURS),
    ("controller sampled at 6 rad/s, fits not told", replace(PRINTED, continuous=False), BY_OURS),
    ("fits told that the torque is replayed held", replace(PRINTED, hold="zero"), BY_OURS),
    ("torque noise of 0.1 N m, not of variance 0.1", replace(PRINTED, torque_variance=0.01), BY_PAPERS),
    ("spacing n_cd", replace(PRINTED, spacing="n_cd"), BY_PAPERS),
    ("spacing n_cd / 2, rounded down", replace(PRINTED, spacing="half"), ("wls", "rls")),
    ("torque low-passed like the angle, (34)", replace(PRINTED, torque_filtered=True), BY_PAPERS),
    *((f"record begins {10 * first} ms after the impact", replace(PRINTED, first=first), BY_OURS) for first in (3, 10)),
    *((f"passive row to {level:g} N m", replace(PRINTED, passive_nm=level), (PAPERS_MLE, KNOWN_WLS, "rls"))
      for level in (0.003, 0.01, 0.03, 0.316, 1.0)),
    *((f"passive row to {level:g} N m, spacing n_cd", replace(PRINTED, passive_nm=level, spacing="n_cd"), ("rls",))
      for level in (0.01, 0.03, 0.316)),
)


@kept
def run(protocol: Protocol, method: str, case: int, runs: int) -> BlockResult:
    """Runs of one method in one case, errors and betas of all."""
    parts = [run_block(Block(REGULAR[case], method, first, min(BLOCK, runs - first), SEED, protocol))
             for first in range(0, runs, BLOCK)]
    return BlockResult(**{name: np.concatenate([getattr(part, name) for part in parts])
                          for name in ("beta", "std", "error", "converged", "failed", "likelihood_ratio")},
                       seconds=sum(part.seconds for part in parts))


def cell(error: np.ndarray) -> tuple[float, float, float, int]:
    """(mean, variance, median, failed) of summed squared errors."""
    good = error[np.isfinite(error)]
    if good.size < 2:
        return np.nan, np.nan, np.nan, int(np.isnan(error).sum())
    return float(good.mean()), float(good.var(ddof=1)), float(np.median(good)), int(np.isnan(error).sum())


def close(value: float, method: str, case: int) -> bool:
    """Within a quarter of the paper."""
    return abs(value / PAPER[method][case][0] - 1.0) <= CLOSE


def page(runs: int = 200) -> Lines:
    rows, reached, close_of = [], set[tuple[str, int]](), dict.fromkeys(METHODS, 0)
    for method in METHODS:
        for case in range(4):
            mean, variance, median, failed = cell(run(PRINTED, method, case, runs).error)
            printed = PAPER[method][case]
            good = close(mean, method, case)
            close_of[method] += good
            reached |= {(method, case)} if good else set()
            rows.append(f"{LABELS[method]} | {case + 1} | {figure(mean)} | {printed[0]:g} | {figure(variance)} "
                        f"| {printed[1]:g} | {figure(median)} | {failed} of {runs} | {printed[2]} of 1000 "
                        f"| {'yes' if good else ''}")
            tell(rows[-1])
    choices = []
    for label, protocol, methods in CHOICES:
        for method in methods:
            cells = []
            for case in range(4):
                mean, _, _, failed = cell(run(protocol, method, case, FEW).error)
                good = close(mean, method, case)
                reached |= {(method, case)} if good else set()
                bold = "**" * good
                cells.append(f"{bold}{figure(mean)}{bold}" + f" ({failed} failed)" * bool(failed))
            choices.append(f"{label} | {figure(error_of_truth(protocol))} | {LABELS[method]} | {' | '.join(cells)}")
            tell(choices[-1])
    best = [max(close_of[method] for method in methods) for methods in PAPERS.values()]
    missing = [f"{name} case {case + 1}" for name, methods in PAPERS.items() for case in range(4)
               if not {(method, case) for method in methods} & reached]
    yield from [
        "# Table III replicated",
        f"Seed {SEED}; each choice below with {FEW} runs. "
        "The paper does not say how its walker was controlled, how torques act between samples, or where it starts. "
        "Its MLE has a mean error of 1.15 to 1.24 at any noise. That is no estimation error: under the protocol here "
        f"the *true* parameters leave {error_of_truth(PRINTED):.3f} rad². A continuous controller drives the walker "
        "from just after an impact. Its torque is logged at 100 Hz, fitted as samples of a smooth function, and "
        "replayed held for 10 ms. Everything else is Tables I and II. "
        "`legid monte-carlo biped3 --protocol printed` runs it."]
    yield table("method | case | mean | paper | variance | paper | median | failed | paper | within 25 %", rows)
    yield from [
        f"Within 25 % of the paper: {sum(best)} of 16 means (the better of our MLE and the paper's, and of both "
        "weightings of WLS). Demanded were 12; no single protocol of this search reaches that.",
        "## How much each open choice moves them",
        "Means of the summed squared error [rad²] in cases 1 to 4; bold: within 25 % of the paper. Each row changes "
        "one thing of the protocol above (two where it says so)."]
    yield table("choice | true parameters | method | case 1 | case 2 | case 3 | case 4", choices)
    yield from [
        "## The variances",
        "Variance of the summed squared error in cases 1 to 3 under torque noise of two variances [N²m²]. Table II "
        "says 0.1; what is printed is what 0.01 gives, noise of 0.1 N m."]
    yield table("method | variance of the torque noise | case 1 | case 2 | case 3", (
        (f"{LABELS[method]}{', paper' * (not variance)}", f"{variance:g}" if variance else "", *(
            figure(cell(run(replace(PRINTED, torque_variance=variance), method, case, FEW).error)[1]) if variance else
            f"{PAPER[method][case][1]:g}" for case in range(3)))
        for method in ("mle", "wls") for variance in (0.1, 0.01, None)))
    yield from [
        "## What fits and what does not",
        "- MLE in cases 1 to 3 is the replay's error: told of the hold, our MLE falls to a hundredth of it.",
        "- RLS below MLE in cases 2 and 3, as printed, comes out: a biased estimate can compensate part of the "
        "replay's error.",
        "- The weight of the passive row decides RLS, WLS with known weights and the paper's MLE in case 3. The paper "
        "gives no value.",
        "- WLS comes out in cases 1 and 2 or in 1 and 3, depending on how half of n_cd is rounded.",
        "- HEKF's printed means of 7 to 1000 are those of a filter that diverged in some runs.",
        f"- Reached by no choice of this search: {', '.join(missing) if missing else 'none'}."]


EVIDENCE = Evidence(
    "Table III of the paper under the protocol that its figures are nearest to", "make replication",
    "replication.md", 13, "12 of 16 means within 25 % of the paper", (r"(\d+ of 16 means)",))
main = program(page)
