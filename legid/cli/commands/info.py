"""`legid info`: what a run file holds."""

from __future__ import annotations

import argparse

from daq import InputError
from experiments.console import warn
from legid.cli.command import Command, argument

COMMAND = Command(
    "info", "look into run files",
    "Streams with their rates, gaps and drops, clocks with their bounds, events, and the rig.",
    (argument("run_files", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz"),))


def run(args: argparse.Namespace) -> int:
    """Print what is in the files, those that cannot be read last."""
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
