"""`legid fit`: identify the mechanism's parameters from runs."""

from __future__ import annotations

import argparse

import legid
from daq import InputError
from estimator import METHODS
from experiments.console import busy
from legid.cli.answer import answer, chosen_rig, given_runs
from legid.cli.arguments import (
    AS_READ,
    DAMAGED,
    FIX,
    FORCE,
    HTML,
    MOST_WORKERS,
    RIG,
    RUNS,
    SENSORS,
    whole_number,
)
from legid.cli.command import Command, argument, one_of, output

COMMAND = Command(
    "fit", "identify parameters from runs",
    "Identify the parameters of the rig's mechanism from one or more runs and print them with their 95 % intervals. "
    "Exit status 1 when the fit did not converge (JSON is written all the same).", (
        RUNS, RIG, DAMAGED, AS_READ,
        argument("--method", choices=METHODS, default="mle",
                 help="mle: maximum likelihood (default); wls: weighted least squares; rls, hekf: recursive"),
        SENSORS,
        argument("--latent", choices=("trajectory", "free"), default="trajectory",
                 help="mle only: one consistent motion (default), or the paper's free samples"),
        FIX,
        argument("--each", action="store_true",
                 help="fit every run alone, side by side; --json then has schema legid.fits/1"),
        one_of(argument("--workers", type=whole_number(1, MOST_WORKERS), metavar="N",
                        help="with --each: local processes; default: one a core"),
               argument("--cluster", metavar="ADDRESS",
                        help="with --each: an existing Dask scheduler that sees the same files")),
        output("--json", lambda args: "legid.fits/1" if args.each else "legid.fit/1",
               help="write the result as JSON (schema legid.fit/1)"),
        HTML,
        output("--model-out", "legid.model/1", "MODEL.json", help="write the model for validate and simulate"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Fit. Raises `WorkError` where the fit is no use."""
    from experiments.judge import Files

    if args.each:
        return _each(args)
    runs, chosen = given_runs(args, args.runs)
    with busy(f"fitting by {args.method}"):
        found = legid.fit(runs, chosen, args.method, args.sensors, dict(args.fix), args.latent)
    files = Files(args.runs, chosen.file, args.model_out)
    return answer(args, found, found.text(files), files)


def _each(args: argparse.Namespace) -> int:
    """Fit every run alone on the executor that was asked for."""
    if args.html or args.model_out:
        raise InputError("--each", "makes no report and no model", "leave out --html and --model-out")
    found = legid.fit_each(args.runs, [chosen_rig(args, [path]) for path in args.runs], args.method, args.sensors,
                           dict(args.fix), args.latent, args.damaged, args.workers, args.cluster)
    answer(args, found, str(found))
    return found.status
