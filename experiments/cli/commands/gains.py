"""`legid gains`: feedforward and PD gains from a model."""

from __future__ import annotations

import argparse

import legid
from experiments.cli.answer import answer
from experiments.cli.arguments import FORCE
from experiments.cli.command import Command, argument, output

COMMAND = Command(
    "gains", "feedforward and PD gains for an identified leg, with their margins",
    "Linearise the model about hanging, and weight errors and torque by their tolerances (LQR by Bryson's rule, as in "
    "SysId). The margins are those of the whole leg, with the delay given. Nothing is sent to a motor.", (
        argument("model", metavar="MODEL.json", help="a model of one driven joint"),
        argument("--angle", metavar="RAD", type=float, default=0.05, help="tolerated error of the angle (0.05)"),
        argument("--speed", metavar="RAD/S", type=float, default=1.0, help="tolerated error of the speed (1)"),
        argument("--torque", metavar="N_M", type=float, default=1.0, help="torque to be spent on them (1)"),
        argument("--delay", metavar="S", type=float, default=0.002, help="everything that is late in the loop (0.002)"),
        output("--json", "legid.gains/1", help="write the gains as JSON (schema legid.gains/1)"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Compute, and say what had no part in it."""
    import sys

    found = legid.gains(args.model, args.angle, args.speed, args.torque, args.delay)
    if found.left_out:
        print(f"note: the model's effects take no part: {', '.join(found.left_out)}", file=sys.stderr)
    return answer(args, found, str(found))
