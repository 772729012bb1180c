"""`legid diagnose`: what the simulation gets wrong, why, and what extending it gains."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import (
    MOST_WORKERS,
    add_force,
    add_output,
    add_rig,
    assignment,
    chosen_rig,
    share,
    whole_number,
)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "diagnose", help="name what the model gets wrong and measure what extending it gains",
        description="Fit the nominal model and test its residual for causes. Name the cause if the data determine it. "
                    "Measure on held-out runs how much the extended model gains. Give several runs "
                    "(eight of 20 s are good) in the order in which they were recorded. Exit status 1 when no "
                    "diagnosis is possible; the JSON is written all the same.")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    add_output(parser, "--json", "legid.diagnosis/1", help="write the diagnosis as JSON (schema legid.diagnosis/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_output(parser, "--model-out", "legid.model/1", "MODEL.json",
               help="write the extended model (the nominal one where nothing was named) for validate and simulate")
    add_force(parser)
    parser.add_argument("--seed", metavar="N", type=whole_number(0, 2**32 - 1), default=0,
                        help="seed of the bootstrap replicates and intervals; default: 0")
    parser.add_argument("--material", metavar="SHARE", type=share, default=0.1,
                        help="smallest relative reduction of the free-run rms error that counts as material; "
                             "default: 0.1")
    parser.add_argument("--workers", metavar="N", type=whole_number(1, MOST_WORKERS),
                        help="processes that share the work; default: one a core")
    parser.add_argument("--fix", metavar="NAME=VALUE", action="append", default=[], type=assignment,
                        help="give a parameter, as runs without a torque need for their scale; may be repeated")
    parser.add_argument("--reference", metavar="MODEL.json",
                        help="an earlier model of this rig: parameters that changed are reported, a payload for one")
    parser.add_argument("--against", metavar="REFERENCE", nargs="+", default=[],
                        help="earlier runs of this rig, folders of them, or the model that legid diagnose wrote of "
                             "them: say what changed since")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Diagnose, print, write what was asked for. Raises `WorkError` with the verdict fit_failed."""
    if args.against:
        return _run_against(args)
    from daq import WorkError
    from experiments.console import command_line, stages, warn
    from experiments.judge import Files
    from experiments.provenance import origin_of
    from legid import diagnose, load, model, save_model

    chosen = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, chosen.source, args.reference, args.seed, command=command_line())
    runs = load(args.runs, chosen.rig, args.damaged)
    with stages("diagnosing") as show:
        found = diagnose(runs, chosen.rig, args.seed, args.reference, show, args.workers, args.material, dict(args.fix))
    found.provenance = origin
    for text in found.prepared.warnings:
        warn(text)
    files = Files(args.runs, chosen.file, args.model_out, args.json)
    if found.verdict != "fit_failed":
        # before any file: a full disk must not take minutes of work with it
        print(found.text(files), flush=True)
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html, files)
    if found.verdict == "fit_failed":
        raise WorkError(found.sentence)
    if args.model_out:
        save_model(model(found), args.model_out)
    return 0


def _run_against(args: argparse.Namespace) -> int:
    """Say what changed since the reference runs. Raises `WorkError` with the verdict fit_failed."""
    from daq import InputError, WorkError
    from experiments.console import command_line
    from experiments.judge import Files
    from experiments.provenance import origin_of
    from experiments.workflows import runs_in
    from legid import diagnose, load

    for option, given in (("--model-out", args.model_out), ("--reference", args.reference),
                          ("--fix", args.fix)):
        if given:
            raise InputError(option, "does not go with --against", "leave it out; --json holds the whole answer")
    runs = runs_in(args.runs)
    models = [path for path in args.against if path.lower().endswith(".json")]
    if models and len(args.against) > 1:
        raise InputError(models[0], "is a model, and is not the only reference", "give one model, or runs alone")
    against = runs_in(args.against) if not models else []
    chosen = chosen_rig(args, runs)
    origin = origin_of(runs, chosen.source, models[0] if models else None, command=command_line())
    later = load(runs, chosen.rig, args.damaged)
    found = diagnose(later, chosen.rig, against=models[0] if models else load(against, chosen.rig, args.damaged))
    found.provenance = origin
    files = Files(runs, chosen.file, document=args.json)
    if found.verdict != "fit_failed":
        print(found.text(files), flush=True)
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html, files)
    if found.verdict == "fit_failed":
        raise WorkError(found.sentence)
    return 0
