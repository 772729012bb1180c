"""`legid demo`: the whole loop, no hardware needed."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "demo", help="the whole loop on an emulated rig: record, fit, validate, report",
        description="Emulate a leg with its IMU and motor controller, byte for byte; excite it, record it, identify "
                    "it, validate the model on a run of its own and write a report. Takes well under a minute.")
    parser.add_argument("--out", metavar="DIR", default="demo-out", help="where the files go; default: demo-out")
    parser.add_argument("--seconds", type=_seconds, default=20.0, help="length of each of the three runs; default: 20")
    parser.add_argument("--seed", type=_seed, default=1, help="noise and excitation are drawn from it; default: 1")
    parser.set_defaults(run=run)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 5.0 <= value <= 600.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not between 5 and 600 seconds")
    return value


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**20:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number below {2**20}")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Run the demo and say what was found and where it is."""
    from pathlib import Path

    from experiments.demo import run_demo
    from experiments.demo_text import demo_text

    print(demo_text(run_demo(Path(args.out), args.seconds, args.seed)))
    return 0
