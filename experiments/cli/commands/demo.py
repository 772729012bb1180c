"""`legid demo`: the whole loop, no hardware needed."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, whole_number

HIDEABLE = ("none", "stribeck_friction", "asymmetric_friction", "rotor_inertia", "joint_stiffness", "quadratic_drag",
            "torque_offset", "gyro_bias", "sensor_time_skew")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "demo", help="the whole loop on an emulated rig: record, fit, diagnose, extend, report",
        description="Emulate a leg with its IMU and motor controller, byte for byte, with an effect hidden in it that "
                    "the model does not know; excite it, record it, identify it, find out what the model gets wrong, "
                    "extend it, and write reports. Takes two minutes or three.")
    parser.add_argument("--out", metavar="DIR", default="demo-out",
                        help="where the files go, over those of an earlier demo; default: demo-out")
    parser.add_argument("--effect", metavar="NAME", choices=HIDEABLE, default="joint_stiffness",
                        help=f"what is hidden in the leg: {', '.join(HIDEABLE)}; default: joint_stiffness")
    parser.add_argument("--drive", metavar="KIND", default="legid",
                        help="what turns the knee: legid (our own firmware, the default), moteus or another drive that "
                             "has an emulator")
    parser.add_argument("--runs", metavar="N", type=_runs, default=8, help="number of runs; default: 8")
    parser.add_argument("--seconds", metavar="S", type=_seconds, default=10.0, help="length of each run; default: 10")
    parser.add_argument("--seed", metavar="N", type=parse_seed, default=1,
                        help="noise and excitation are drawn from it; default: 1")
    add_force(parser)
    parser.set_defaults(run=run)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 5.0 <= value <= 600.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 5 and 600 seconds")
    return value


def _runs(text: str) -> int:
    if not text.isdecimal() or not 4 <= int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of runs between 4 and 100")
    return int(text)


parse_seed = whole_number(0, 2**20 - 1)
"""A seed of an emulated leg."""


def run(args: argparse.Namespace) -> int:
    """Run the demo and say what was hidden, what was found and where it is."""
    from pathlib import Path

    from experiments.workflows import demo_text, run_demo

    print(demo_text(run_demo(Path(args.out), args.seconds, args.seed, args.effect, args.runs,
                             drive=args.drive)))
    return 0
