"""`legid simulate`: run a model under a torque plan."""

from __future__ import annotations

import argparse
import warnings

import legid
from experiments.console import busy, warn
from legid.cli.arguments import FORCE, MODEL, number
from legid.cli.command import Command, argument, output

WIDEST_RAD = 6.2832


def _angles(text: str) -> list[float]:
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of angles like 0.1,0.2") from None
    if not all(abs(angle) <= WIDEST_RAD for angle in angles):  # NaN too
        raise argparse.ArgumentTypeError(f"{text!r} is more than a turn; angles are in rad, not in degrees")
    return angles


COMMAND = Command(
    "simulate", "run a model under a torque plan",
    "Simulate the model from rest under the plan's torque and write a run as CSV: angles, torque and, for a leg with "
    "an IMU, what the IMU would read.", (
        MODEL,
        argument("--plan", required=True,
                 help="torque plan: CSV with time_s,tau2_cmd_nm; or a run, for its measured torque; with --rig the "
                      "commands q2_cmd_rad"),
        argument("--rig", help="rig file whose [servo] follows the plan's commands"),
        output("--out", "run", "RUN.csv", required=True,
               help="the run to write (.csv or .csv.gz); a run that is there is never overwritten"),
        FORCE,
        argument("--rate", metavar="HZ", type=number(lambda hz: 0.0 < hz < 1e6, "a rate in Hz"),
                 help="samples per second; default: the plan's own rate"),
        argument("--start", metavar="Q1,Q2", type=_angles, help="angles at the start [rad]; default: all zero"),
        argument("--noise-seed", metavar="N", type=int,
                 help="add the model's own noise levels to the samples, drawn with this seed; default: none")))


def run(args: argparse.Namespace) -> int:
    """Simulate and write the run."""
    from daq.runs import write_csv

    with busy("simulating"), warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always", UserWarning)
        data = legid.simulate(args.model, args.plan, args.rate, args.start, args.noise_seed, args.rig)
    rows = write_csv(data, args.out)
    for note in notes:
        warn(str(note.message))
    print(f"{args.out}: {rows} samples, {len(data) / data.rate_hz:.1f} s at {data.rate_hz:g} Hz")
    return 0
