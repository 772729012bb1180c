"""`legid export`: a run or a model in another format."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output

KINDS = ("csv", "parquet", "mat", "ros2", "mjcf", "urdf")
ENDINGS = {".csv": "csv", ".csv.gz": "csv", ".parquet": "parquet", ".mat": "mat", ".mcap": "ros2",
           ".xml": "mjcf", ".mjcf": "mjcf", ".urdf": "urdf"}


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "export", help="convert a run to CSV, Parquet, MATLAB or ROS 2, a model to MJCF or URDF",
        description="Align a run to a uniform grid and write it in another format, one column a signal, SI units. "
                    "A native run carries its rig; --rig overrides it. With --to ros2 it becomes an MCAP of "
                    "sensor_msgs, every sample at its own wall-clock time; with --to mjcf or urdf a MODEL.json becomes "
                    "a simulator's model.")
    parser.add_argument("run_file", metavar="RUN", help="run file of any kind that is read; or MODEL.json")
    parser.add_argument("--to", choices=KINDS, help="the format; default: by the ending of FILE")
    add_output(parser, "--out", None, required=True, help="the file to write; a run that is there is never overwritten")
    add_force(parser)
    parser.add_argument("--rig", help="the rig's TOML file; default: the one inside the run")
    parser.add_argument("--damaged", action="store_true", help="export a run of whose file something is missing, too")
    parser.add_argument("--rate", metavar="HZ", type=float, help="samples per second; default: the rig's")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, align, write."""
    from daq import InputError

    if args.to is None:
        args.to = next((kind for ending, kind in ENDINGS.items() if args.out.lower().endswith(ending)), None)
    if args.to is None:
        raise InputError(args.out, "has no ending that tells a format", f"give --to {'|'.join(KINDS)}")
    if args.to in ("mjcf", "urdf"):
        return _export_model(args)
    from experiments.console import warn
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


def _export_model(args: argparse.Namespace) -> int:
    """Write the model; what the format cannot hold goes to stderr."""
    import sys

    from daq import InputError
    from experiments.console import write_text
    from experiments.models import export_model, load_model

    if args.rig is not None or args.rate is not None:
        raise InputError(f"--to {args.to}", "takes neither --rig nor --rate", "leave them out: they belong to runs")
    text, notes = export_model(load_model(args.run_file), args.to, args.run_file)
    write_text(args.out, text)
    print(f"{args.out}: {args.to.upper()} model of {args.run_file}")
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    return 0
