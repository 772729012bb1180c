"""`legid gains`: feedforward and PD gains from a model."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "gains", help="feedforward and PD gains for an identified leg, with their margins",
        description="Linearise the model about hanging and weigh errors and torque by what is tolerated of each (LQR "
                    "by Bryson's rule, as SysId does). The margins are those of the whole leg, with the delay given. "
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

    from daq import InputError
    from experiments.console import command_line, text_table, write_json
    from experiments.models import Tolerances, gain_rows, gains_of, load_model
    from experiments.provenance import origin_of

    for name in ("angle", "speed", "torque"):
        if not 0.0 < getattr(args, name) < 1e6:
            raise InputError(f"--{name}", f"{getattr(args, name):g} is not a size to tolerate", "give one above 0")
    if not 0.0 <= args.delay < 1.0:
        raise InputError("--delay", f"{args.delay:g} is not a delay in seconds", "give one from 0 to 1")
    model = load_model(args.model)
    found = gains_of(model, args.model, Tolerances(args.angle, args.speed, args.torque, args.delay))
    print(f"joint {found.joint}: torque = kS sign(v) + kV v + kA a + kG sin(angle) + kP angle error + kD speed error")
    print(text_table(["", "value", "unit", ""], gain_rows(found), {1}))
    if model.effects:
        print("note: the model's effects take no part: " + ", ".join(e.name for e in model.effects), file=sys.stderr)
    if args.json:
        write_json(args.json, {"schema": "legid.gains/1", **found._asdict(), "tolerated": {
            "angle_rad": args.angle, "speed_radps": args.speed, "torque_nm": args.torque}, "delay_s": args.delay,
            "provenance": origin_of(model=args.model, command=command_line())})
    return 0
