"""`legid fit`: identify the mechanism's parameters from runs."""

from __future__ import annotations

import argparse

from estimator import METHODS
from experiments.cli.arguments import MOST_WORKERS, add_fix, add_force, add_output, add_rig, chosen_rig, whole_number


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "fit", help="identify parameters from runs",
        description="Identify the parameters of the rig's mechanism from one or more runs and print them with "
                    "their 95 % intervals. Exit status 1 when the fit did not converge (JSON is written all the same).")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    parser.add_argument("--method", choices=METHODS, default="mle",
                        help="mle: maximum likelihood (default); wls: weighted least squares; rls, hekf: recursive")
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="what gives the pivot's angle; default: imu where all runs have its columns")
    parser.add_argument("--latent", choices=("trajectory", "free"), default="trajectory",
                        help="mle only: one consistent motion (default), or the paper's free samples")
    add_fix(parser)
    parser.add_argument("--each", action="store_true",
                        help="fit every run alone, side by side; --json then has schema legid.fits/1")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=whole_number(1, MOST_WORKERS), metavar="N",
                       help="with --each: local processes; default: one a core")
    where.add_argument("--cluster", metavar="ADDRESS",
                       help="with --each: an existing Dask scheduler that sees the same files")
    add_output(parser, "--json", lambda args: "legid.fits/1" if args.each else "legid.fit/1",
               help="write the result as JSON (schema legid.fit/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_output(parser, "--model-out", "legid.model/1", "MODEL.json", help="write the model for validate and simulate")
    add_force(parser)
    parser.set_defaults(run=run)


def _run_each(args: argparse.Namespace) -> int:
    """Fit every run alone on the executor that was asked for."""
    from pathlib import Path

    from daq import InputError
    from experiments.console import command_line, work_bar, write_json
    from experiments.provenance import origin_of
    from experiments.workflows import Refit, choose_executor, refit_all, refits_document, refits_text, verdict

    if args.html or args.model_out:
        raise InputError("--each", "makes no report and no model", "leave out --html and --model-out")
    rigs = [chosen_rig(args, [run]) for run in args.runs]
    pieces = [Refit(str(Path(run).resolve()), rig.rig, args.method, args.sensors, args.latent, dict(args.fix),
                    args.damaged, origin_of([run], rig.source, command=command_line()))
              for run, rig in zip(args.runs, rigs)]
    with work_bar("fitting", len(pieces), "run") as done:
        fits = refit_all(pieces, choose_executor(args.workers, args.cluster), done)
    print(refits_text(fits))
    if args.json:
        write_json(args.json, refits_document(fits))
    return verdict(fits)


def run(args: argparse.Namespace) -> int:
    """Fit, print, write what was asked for. Raises `WorkError` where the fit is no use."""
    if args.each:
        return _run_each(args)
    from experiments.console import busy, command_line, warn
    from experiments.judge import check_sound
    from experiments.provenance import origin_of
    from legid import fit, load, model, save_model

    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, command=command_line())
    runs = load(args.runs, rig.rig, args.damaged)
    with busy(f"fitting {len(runs)} runs by {args.method}"):
        found = fit(runs, rig.rig, args.method, args.sensors, dict(args.fix), args.latent)
    found.provenance = origin
    print(found.text())
    for flag in found.fitted.flags:
        warn(str(flag))
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html)
    check_sound(found.estimate, bool(args.model_out))
    if args.model_out:
        save_model(model(found), args.model_out)
    return 0
