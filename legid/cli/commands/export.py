"""`legid export`: a run or a model in another format."""

from __future__ import annotations

import argparse

import legid
from daq import InputError
from experiments import workflows
from experiments.console import note, warn
from legid.cli.answer import given_runs
from legid.cli.arguments import FORCE, whole_number
from legid.cli.command import Command, argument, output

KINDS = ("csv", "parquet", "mat", "ros2", "mjcf", "urdf", "mujoco")
COMMAND = Command(
    "export", "convert a run to CSV, Parquet, MATLAB or ROS 2, a model for MuJoCo or as URDF",
    "Align a run to a uniform grid and write it in another format, one column a signal, SI units. A native run carries "
    "its rig; --rig overrides it. With --to ros2 it becomes an MCAP of sensor_msgs, every sample at its own wall-clock "
    "time; with --to mjcf or urdf a MODEL.json becomes a simulator's model. --to mujoco writes a folder with leg.xml "
    "and leg.py, which need no legid.", (
        argument("run_file", metavar="RUN", help="run file of any kind that is read; or MODEL.json"),
        argument("--to", choices=KINDS, help="the format; default: by the ending of FILE"),
        output("--out", None, required=True,
               help="the file to write, with --to mujoco a folder; a run that is there is never overwritten"),
        argument("--starts", metavar="RUN", nargs="+", default=[],
                 help="with --to mujoco: runs whose first states leg.xml keeps, by name"),
        argument("--samples", metavar="N", type=whole_number(1, 10_000), default=0,
                 help="with --to mujoco: N models more, drawn by the joint covariance of parameters and sizes"),
        argument("--seed", type=whole_number(0, 2**32), default=1, help="of --samples (default 1)"),
        FORCE,
        argument("--rig", help="the rig's TOML file; default: the one inside the run; with --to urdf: whose limits the "
                               "joints get"),
        argument("--damaged", action="store_true", help="export a run of whose file something is missing, too"),
        argument("--rate", metavar="HZ", type=float, help="samples per second; default: the rig's")))


def run(args: argparse.Namespace) -> int:
    """Write, and tell what the files do not hold."""
    kind = workflows.export_kind(args.out, args.to)
    _check(args, kind)
    workflows.check_wanted(kind, bool(args.starts), args.samples)
    starts, rig = given_runs(args, args.starts) if args.starts else ((), args.rig)
    done = legid.export(args.run_file, args.out, kind, rig=rig, starts=starts, samples=args.samples, seed=args.seed,
                        rate_hz=args.rate, damaged=args.damaged)
    print(done.text)
    for line in done.notes:
        if kind in ("ros2", *workflows.OF_MODELS):
            note(f"note: {line}")
        else:
            warn(line)
    return 0


def _check(args: argparse.Namespace, kind: str) -> None:
    """Raises `InputError` for options that the format does not take."""
    if kind == "ros2" and args.rate is not None:
        raise InputError("--to ros2", "takes no --rate", "leave it out: every sample keeps its own time")
    if kind == "mujoco" and (args.rate is not None or (args.rig is not None and not args.starts)):
        raise InputError("--to mujoco", "takes no --rate, and --rig with --starts alone", "leave it out")
    if kind in ("mjcf", "urdf") and (args.rate is not None or (args.rig is not None and kind != "urdf")):
        raise InputError(f"--to {kind}", "takes no --rate, and --rig for URDF alone", "leave them out")
