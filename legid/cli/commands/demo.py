"""`legid demo`: the whole loop, no hardware needed."""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments import workflows
from legid.cli.arguments import DRIVE, FORCE, HIDEABLE, SEED, number
from legid.cli.command import Command, argument


def _runs(text: str) -> int:
    if not text.isdecimal() or not 4 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of runs between 4 and 100")
    return int(text)


COMMAND = Command(
    "demo", "the whole loop on an emulated rig: record, fit, diagnose, extend, report",
    "Emulate a leg with its IMU and motor controller, byte for byte, with an effect hidden in it that the model does "
    "not know; excite it, record it, identify it, find out what the model gets wrong, extend it, and write reports. "
    "Takes two minutes or three.", (
        argument("--out", metavar="DIR", default="demo-out",
                 help="where the files go, over those of an earlier demo; default: demo-out"),
        argument("--effect", metavar="NAME", choices=HIDEABLE, default="joint_stiffness",
                 help=f"what is hidden in the leg: {', '.join(HIDEABLE)}; default: joint_stiffness"),
        DRIVE,
        argument("--runs", metavar="N", type=_runs, default=8, help="number of runs; default: 8"),
        argument("--seconds", metavar="S", type=number(lambda s: 5.0 <= s <= 600.0, "between 5 and 600 seconds"),
                 default=10.0, help="length of each run; default: 10"),
        argument("--seed", metavar="N", type=SEED, default=1,
                 help="noise and excitation are drawn from it; default: 1"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Run the demo and say what was hidden, what was found and where it is."""
    print(workflows.demo_text(workflows.run_demo(Path(args.out), args.seconds, args.seed, args.effect, args.runs,
                                                 drive=args.drive)))
    return 0
