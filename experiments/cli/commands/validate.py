"""`legid validate`: free-run simulation of a model against runs."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output, add_rig, chosen_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "validate", help="compare a model's free-run simulation with runs",
        description="Simulate the model from each run's first state under its measured torque alone, and compare "
                    "with what was measured. Use runs that the fit has not seen.")
    parser.add_argument("model", metavar="MODEL.json", help="a model written by legid fit --model-out")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="what the pivot's angle is compared with; default: imu where all runs have its columns")
    add_output(parser, "--json", "legid.validation/1", help="write the errors as JSON (schema legid.validation/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, compare, print, write what was asked for."""
    import numpy as np

    from experiments.console import write_json
    from experiments.models import load_model
    from experiments.provenance import origin_of
    from experiments.reports import validation_document, validation_section, validation_text, with_origin
    from experiments.rig import load_setup
    from experiments.workflows import validate_runs

    model = load_model(args.model)
    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, args.model)
    setup = load_setup(args.runs, rig.rig, args.sensors, beta=np.array(model.beta), damaged=args.damaged)
    validations = validate_runs(model, setup, args.model)
    print(validation_text(validations))
    if args.json:
        document = validation_document(validations, setup.options.sensors)
        write_json(args.json, with_origin(document, origin, setup.datasets))
    if args.html:
        from experiments.reports import origin_section, write_page

        write_page(args.html, f"Validation of {args.model}",
                   f"{model.mechanism.model}, fitted by {model.provenance.method} to "
                   f"{', '.join(model.provenance.runs)}, simulated against {len(validations)} runs.",
                   [validation_section(validations), origin_section(origin, setup.datasets)], origin)
    return 0
