"""`legid gains`: feedforward and PD gains from a model."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "gains", help="feedforward and PD gains for an identified leg, with their margins",
        description="Linearise the model about hanging, and weight errors and torque by their tolerances (LQR by "
                    "Bryson's rule, as in SysId). The margins are those of the whole leg, with the delay given. "
                    "Nothing is sent to a motor.")
    parser.add_argument("model", metavar="MODEL.json", help="a model of one driven joint")
    parser.add_argument("--angle", metavar="RAD", type=float, default=0.05, help="tolerated error of the angle (0.05)")
    parser.add_argument("--speed", metavar="RAD/S", type=float, default=1.0, help="tolerated error of the speed (1)")
    parser.add_argument("--torque", metavar="N_M", type=float, default=1.0, help="torque to be spent on them (1)")
    parser.add_argument("--delay", metavar="S", type=float, default=0.002,
                        help="everything that is late in the loop (0.002)")
    add_output(parser, "--json", "legid.gains/1", help="write the gains as JSON (schema legid.gains/1)")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compute, print, write what was asked for."""
    import sys

    from experiments.console import command_line, write_json
    from experiments.models import Tolerances, gains_document, gains_of, gains_text, load_model
    from experiments.provenance import origin_of

    model, wanted = load_model(args.model), Tolerances(args.angle, args.speed, args.torque, args.delay)
    found = gains_of(model, args.model, wanted)
    print(gains_text(found))
    left_out = [*(e.name for e in model.effects), *(["structure"] if model.structure else [])]
    if left_out:
        print("note: the model's effects take no part: " + ", ".join(left_out), file=sys.stderr)
    if args.json:
        write_json(args.json, {**gains_document(found, wanted),
                               "provenance": origin_of(model=args.model, command=command_line())})
    return 0
