"""`legid monte-carlo`: the simulation study of the paper's section V."""

from __future__ import annotations

import argparse

from estimator import METHODS
from legid.cli.arguments import FORCE, whole_number
from legid.cli.command import Command, argument, one_of, output
from legid.cli.source_tree import study

CHOICES = (*METHODS, "mle-free", "wls-known")
MOST_RUNS = 1_000_000


def _cases(text: str) -> tuple[int, ...]:
    found = text.split(",")
    if not all(part in ("1", "2", "3", "4", "5") for part in found):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of cases from 1 to 5")
    return tuple(sorted({int(part) for part in found}))


def _methods(text: str) -> tuple[str, ...]:
    found = text.split(",")
    for part in found:
        if part not in CHOICES:
            raise argparse.ArgumentTypeError(f"{part!r} is none of {', '.join(CHOICES)}")
    return tuple(m for m in CHOICES if m in found)


COMMAND = Command(
    "monte-carlo", "the simulation study of the paper, Table III",
    "Simulate noisy records of one step of the three-link walker, fit each by every method, simulate the models freely "
    "and print Table III next to the paper's numbers. The same command continues an interrupted study. It needs "
    "legid's source tree.", (
        argument("model", choices=("biped3",), help="the walker of section V"),
        argument("--runs", type=whole_number(1, MOST_RUNS), default=1000, help="runs a case; default: 1000"),
        argument("--cases", type=_cases, default=(1, 2, 3, 4, 5), metavar="1,2,...",
                 help="columns of Table II, and 5 for the failing case; default: all"),
        argument("--methods", type=_methods, default=METHODS, metavar="mle,wls,...",
                 help="default: mle,wls,rls,hekf; mle-free is the paper's own MLE, with free latents and central "
                      "differences, wls-known least squares with the known torque covariance"),
        argument("--protocol", choices=("ours", "printed"), default="ours",
                 help="ours: the torque acts as every method is told, true parameters leave no error (default); "
                      "printed: as the paper's figures come out, a continuous controller's torque logged at 100 Hz and "
                      "replayed held"),
        argument("--seed", type=whole_number(0, 2**31 - 1), default=1, help="all noise is drawn from it; default: 1"),
        one_of(argument("--workers", type=whole_number(1, MOST_RUNS), metavar="N",
                        help="local processes; default: one a core"),
               argument("--cluster", metavar="ADDRESS", help="an existing Dask scheduler, e.g. tcp://host:8786")),
        argument("--out", metavar="DIR", default="monte-carlo-out",
                 help="where finished work is kept, with runs.parquet and report.html; default: monte-carlo-out"),
        output("--json", "legid.monte-carlo/1", help="write the table as JSON (schema legid.monte-carlo/1)"),
        FORCE,
        argument("--note", default="", metavar="TEXT", help="a sentence for the end of the page")))


def run(args: argparse.Namespace) -> int:
    """Run the study."""
    return study("run_monte_carlo")(args)
