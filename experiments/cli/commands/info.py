"""`legid info`: what a run file holds."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "info", help="look into run files",
        description="Streams with their rates, gaps and drops, clocks with their bounds, events, and the rig.")
    parser.add_argument("run_files", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print what is in the files, those that cannot be read last."""
    from daq import InputError
    from experiments.console import warn

    faults = []
    for k, path in enumerate(args.run_files):
        try:
            text = _described(path)
        except InputError as error:
            faults.append(error)
            continue
        print(("\n" if k else "") + text)
    for fault in faults[1:]:
        warn(str(fault))
    if faults:
        raise faults[0]
    return 0


def _described(path: str) -> str:
    from daq.runs import read_csv, read_run
    from experiments.reports import describe_csv, describe_mcap

    return describe_mcap(read_run(path)) if path.lower().endswith(".mcap") else describe_csv(read_csv(path))
