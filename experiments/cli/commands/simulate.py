"""`legid simulate`: run a model under a torque plan."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output

WIDEST_RAD = 6.2832


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "simulate", help="run a model under a torque plan",
        description="Simulate the model from rest under the plan's torque and write a run as CSV: angles, torque "
                    "and, for a leg with an IMU, what the IMU would read.")
    parser.add_argument("model", metavar="MODEL.json", help="a model written by legid fit --model-out")
    parser.add_argument("--plan", required=True,
                        help="torque plan: CSV with time_s,tau2_cmd_nm; or a run, for its measured torque; with --rig "
                             "the commands q2_cmd_rad")
    parser.add_argument("--rig", help="rig file whose [servo] follows the plan's commands")
    add_output(parser, "--out", "run", "RUN.csv", required=True,
               help="the run to write (.csv or .csv.gz); a run that is there is never overwritten")
    add_force(parser)
    parser.add_argument("--rate", metavar="HZ", type=_positive, help="samples per second; default: the plan's own rate")
    parser.add_argument("--start", metavar="Q1,Q2", type=_angles, help="angles at the start [rad]; default: all zero")
    parser.add_argument("--noise-seed", metavar="N", type=int,
                        help="add the model's own noise levels to the samples, drawn with this seed; default: none")
    parser.set_defaults(run=run)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a rate in Hz")
    return value


def _angles(text: str) -> list[float]:
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of angles like 0.1,0.2") from None
    if not all(abs(angle) <= WIDEST_RAD for angle in angles):  # NaN too
        raise argparse.ArgumentTypeError(f"{text!r} is more than a turn; angles are in rad, not in degrees")
    return angles


def run(args: argparse.Namespace) -> int:
    """Simulate and write the run."""
    from daq import load_rig
    from daq.runs import write_csv
    from experiments.console import busy, warn
    from experiments.models import load_model, range_note_of
    from experiments.workflows import follow_commands, plan_for, simulate_run

    model = load_model(args.model)
    plan = None if args.rig else plan_for(args.plan, model)
    with busy("simulating"):
        data = (follow_commands(model, args.plan, load_rig(args.rig), args.model, args.start) if plan is None else
                simulate_run(model, plan, args.model, args.rate, args.start, args.noise_seed))
    rows = write_csv(data, args.out)
    note = range_note_of(model, data)
    if note:
        warn(note)
    print(f"{args.out}: {rows} samples, {len(data) / data.rate_hz:.1f} s at {data.rate_hz:g} Hz")
    return 0
