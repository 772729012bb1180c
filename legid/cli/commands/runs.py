"""`legid runs`: what has been recorded."""

from __future__ import annotations

import argparse
from datetime import date

import legid
from estimator import EVERY_VERDICT
from experiments import reports
from legid.cli.answer import answer
from legid.cli.arguments import FORCE
from legid.cli.command import Command, argument, output


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a date like 2026-11-21") from None


COMMAND = Command(
    "runs", "list recorded runs with their verdicts",
    "Every .mcap file in DIR and below, oldest first, then runs as CSV: when, how long, which rig, how well its clock "
    "is known, what was lost, and the verdict of the newest diagnosis JSON in its folder that used it.", (
        argument("folder", metavar="DIR", help="folder with run files, or one run"),
        argument("--model", help="only runs of this rig model (leg2, ...)"),
        argument("--since", metavar="DATE", type=_day, help="only runs recorded on this day (UTC) or later"),
        argument("--until", metavar="DATE", type=_day, help="only runs recorded on this day (UTC) or before"),
        argument("--verdict", choices=(*EVERY_VERDICT, "-"),
                 help="only runs with this verdict; -: not diagnosed yet"),
        argument("--faulty", action="store_true", help="only runs that lost something or ended early"),
        output("--json", "legid.runs/1", "F", help="write the list as JSON too"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """List those that were asked for."""
    found = legid.list_runs(args.folder, args.model, args.since, args.until, args.verdict, args.faulty)
    answer(args, found, str(found))
    if others := reports.other_tables(args.folder):
        print(f"{len(others)} CSV files of other programs: legid import {others[0]} --guess finds their columns")
    print(f"{len(found)} of {found.of} runs" if len(found) < found.of else f"{found.of} runs")
    return 0
