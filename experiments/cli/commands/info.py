"""`legid info`: what a run file holds."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "info", help="look into a run file",
        description="Streams with their rates, gaps and drops, clocks with their bounds, events, and the rig.")
    parser.add_argument("run_file", metavar="RUN", help="run file: .mcap, .csv or .csv.gz")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print what is in the file."""
    from experiments.reports import describe_csv, describe_mcap

    if args.run_file.lower().endswith(".mcap"):
        from daq.runs import read_run

        print(describe_mcap(read_run(args.run_file)))
    else:
        from daq.runs import read_csv

        print(describe_csv(read_csv(args.run_file)))
    return 0
