"""`legid export`: a run in another format."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "export", help="convert a run to CSV, Parquet or MATLAB",
        description="Align a run to a uniform grid and write it in another format, one column a signal, SI units. "
                    "A native run carries its rig; --rig overrides it.")
    parser.add_argument("run_file", metavar="RUN", help="run file: .mcap, .csv or .csv.gz")
    parser.add_argument("--to", required=True, choices=("csv", "parquet", "mat"), help="the format")
    parser.add_argument("--out", metavar="FILE", required=True, help="the file to write")
    parser.add_argument("--rig", help="the rig's TOML file; default: the one inside the run")
    parser.add_argument("--rate", metavar="HZ", type=float, help="samples per second; default: the rig's")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, align, write."""
    from experiments.exports import export_run, load_any

    data = load_any(args.run_file, args.rig, args.rate)
    rows = export_run(data, args.to, args.out)
    print(f"{args.out}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}")
    return 0
