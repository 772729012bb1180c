"""`legid compare`: two models side by side on runs that neither has seen."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_horizons, add_output, add_rig, chosen_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "compare", help="two models side by side: parameters, and free-run errors over horizons",
        description="Put two models side by side: parameters with intervals and the difference in standard deviations, "
                    "and free-run errors over horizons from 0.1 s to whole runs, with an interval for who is better. "
                    "Use runs that neither model was fitted to.")
    parser.add_argument("model_a", metavar="A.json", help="a model written by legid fit or diagnose --model-out")
    parser.add_argument("model_b", metavar="B.json", help="the other")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="what gives the pivot's angle; default: imu where all runs have its columns")
    add_horizons(parser)
    add_output(parser, "--json", "legid.comparison/1", help="write the result as JSON (schema legid.comparison/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compare, print, write what was asked for."""
    from pathlib import Path

    from estimator.prediction import HORIZONS_S
    from experiments.console import command_line, write_json
    from experiments.models import load_model
    from experiments.provenance import origin_of
    from experiments.reports import comparison_document, comparison_text, with_origin
    from experiments.session import load_runs
    from experiments.workflows import compare_models

    paths = args.model_a, args.model_b
    models = load_model(paths[0]), load_model(paths[1])
    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, models=paths, command=command_line())
    runs = load_runs(args.runs, rig.rig, args.damaged)
    files = (Path(paths[0]).name, Path(paths[1]).name)
    found = compare_models(models, paths if files[0] == files[1] else files, runs, rig.rig, args.sensors,
                           args.horizons or HORIZONS_S)
    print(comparison_text(found))
    if args.json:
        write_json(args.json, with_origin(comparison_document(found), origin, runs))
    if args.html:
        from experiments.reports import comparison_sections, comparison_trust, origin_section, write_page

        write_page(args.html, f"{found.files[0]} (A) against {found.files[1]} (B)",
                   f"Two models of {models[0].mechanism.model} on {len(runs)} run{'s' * (len(runs) != 1)}.",
                   [*comparison_sections(found), origin_section(origin, runs)], origin,
                   comparison_trust(found).verdict())
    return 0
