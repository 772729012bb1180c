"""`legid export`: a run or a model in another format."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from experiments.cli.arguments import add_force, add_output, whole_number

if TYPE_CHECKING:
    from experiments.session import Prepared
    from experiments.workflows import Wanted

KINDS = ("csv", "parquet", "mat", "ros2", "mjcf", "urdf", "mujoco", "learning")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "export", help="convert a run to CSV, Parquet, MATLAB or ROS 2, a model for MuJoCo or as URDF",
        description="Align a run to a uniform grid and write it in another format, one column a signal, SI units. "
                    "A native run carries its rig; --rig overrides it. With --to ros2 it becomes an MCAP of "
                    "sensor_msgs, every sample at its own wall-clock time; with --to mjcf or urdf a MODEL.json becomes "
                    "a simulator's model. --to mujoco writes a folder with leg.xml and leg.py, which need no legid; "
                    "--to learning one with modules for Isaac Lab, mjlab, Newton and Genesis.")
    parser.add_argument("run_file", metavar="RUN", help="run file of any kind that is read; or MODEL.json")
    parser.add_argument("--to", choices=KINDS, help="the format; default: by the ending of FILE")
    add_output(parser, "--out", None, required=True,
               help="the file to write, with --to mujoco or learning a folder; a run that is there is never "
                    "overwritten")
    parser.add_argument("--starts", metavar="RUN", nargs="+", default=[],
                        help="with --to mujoco: runs whose first states leg.xml keeps, by name; with --to learning: "
                             "runs whose free-run error says what a simulator's joint lacks")
    parser.add_argument("--servo", metavar="NAME", default="",
                        help="with --to learning: the driven joint's actuator, as BAM names it (mx106), whose "
                             "friction bam.json has")
    parser.add_argument("--samples", metavar="N", type=whole_number(1, 10_000), default=0,
                        help="with --to mujoco: N models more, drawn by the joint covariance of parameters and sizes")
    parser.add_argument("--seed", type=whole_number(0, 2**32), default=1, help="of --samples (default 1)")
    add_force(parser)
    parser.add_argument("--rig", help="the rig's TOML file; default: the one inside the run; with --to urdf: "
                                     "whose limits the joints get")
    parser.add_argument("--damaged", action="store_true", help="export a run of whose file something is missing, too")
    parser.add_argument("--rate", metavar="HZ", type=float, help="samples per second; default: the rig's")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, align, write."""
    from experiments.console import warn
    from experiments.workflows import OF_MODELS, Wanted, check_wanted, export_kind

    args.to = export_kind(args.out, args.to)
    wanted = Wanted(samples=args.samples, seed=args.seed, servo=args.servo)
    check_wanted(args.to, wanted, bool(args.starts))
    if args.to in OF_MODELS:
        return _export_model(args, wanted)
    from experiments.exchange import export_run, load_to_convert
    from experiments.session import require_whole

    if args.to == "ros2":
        return _export_ros2(args)
    data = require_whole(load_to_convert(args.run_file, args.rig, args.rate), args.damaged)
    if data.damage:
        warn(f"{data.name} is damaged: {'; '.join(map(str, data.damage))}")
    rows = export_run(data, args.to, args.out)
    print(f"{args.out}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}")
    return 0


def _export_ros2(args: argparse.Namespace) -> int:
    """Write the messages; what they do not hold goes to stderr."""
    import sys

    from daq import InputError
    from experiments.exchange import export_ros2

    if args.rate is not None:
        raise InputError("--to ros2", "takes no --rate", "leave it out: every sample keeps its own time")
    done = export_ros2(args.run_file, args.rig, args.out)
    print(f"{args.out}: {done.messages} messages of {args.run_file}")
    for note in done.notes:
        print(f"note: {note}", file=sys.stderr)
    return 0


def _export_model(args: argparse.Namespace, wanted: Wanted) -> int:
    """Write the model; what the format cannot hold goes to stderr."""
    from dataclasses import replace

    from daq import InputError, load_rig
    from experiments.console import note
    from experiments.models import load_model
    from experiments.workflows import export_model_as

    if args.to in ("mujoco", "learning"):
        wanted = replace(wanted, starts=_prepared(args))
    elif args.rate is not None or (args.rig is not None and args.to != "urdf"):
        raise InputError(f"--to {args.to}", "takes no --rate, and --rig for URDF alone", "leave them out")
    elif args.rig is not None:
        wanted = replace(wanted, limits=load_rig(args.rig).limits)
    done = export_model_as(args.to, load_model(args.run_file), args.run_file, args.out, wanted)
    print(done.text)
    for line in done.notes:
        note(f"note: {line}")
    return 0


def _prepared(args: argparse.Namespace) -> Prepared | None:
    """The runs of --starts, ready; None without any."""
    from daq import InputError

    if args.rate is not None or (args.rig is not None and not args.starts):
        raise InputError(f"--to {args.to}", "takes no --rate, and --rig with --starts alone", "leave it out")
    if not args.starts:
        return None
    import numpy as np

    from experiments.cli.arguments import chosen_rig
    from experiments.models import load_model
    from experiments.session import prepare

    beta = np.array(load_model(args.run_file).beta)
    return prepare(args.starts, chosen_rig(args, args.starts).rig, beta=beta, damaged=args.damaged)
