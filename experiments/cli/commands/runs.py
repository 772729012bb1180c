"""`legid runs`: what has been recorded."""

from __future__ import annotations

import argparse
from datetime import date

from estimator import EVERY_VERDICT
from experiments.cli.arguments import add_force, add_output


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "runs", help="list recorded runs with their verdicts",
        description="Every .mcap file in DIR and below, oldest first, then runs as CSV: when, how long, which rig, "
                    "how well its clock is known, what was lost, and the verdict of the newest diagnosis JSON in its "
                    "folder that used it.")
    parser.add_argument("folder", metavar="DIR", help="folder with run files, or one run")
    parser.add_argument("--model", help="only runs of this rig model (leg2, ...)")
    parser.add_argument("--since", metavar="DATE", type=_day, help="only runs recorded on this day (UTC) or later")
    parser.add_argument("--until", metavar="DATE", type=_day, help="only runs recorded on this day (UTC) or before")
    parser.add_argument("--verdict", choices=(*EVERY_VERDICT, "-"),
                        help="only runs with this verdict; -: not diagnosed yet")
    parser.add_argument("--faulty", action="store_true", help="only runs that lost something or ended early")
    add_output(parser, "--json", "legid.runs/1", "F", help="write the list as JSON too")
    add_force(parser)
    parser.set_defaults(run=run)


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a date like 2026-11-21") from None


def run(args: argparse.Namespace) -> int:
    """Read, choose, print."""
    from pathlib import Path

    from experiments.console import command_line, write_json
    from experiments.provenance import origin_of
    from experiments.reports import choose, list_runs, other_tables, runs_document, runs_text

    every = list_runs(args.folder)
    lines = choose(every, args.model, args.since, args.until, args.verdict, args.faulty)
    if args.json:
        folder = Path(args.folder) if Path(args.folder).is_dir() else Path(args.folder).parent
        origin = origin_of([folder / line.file for line in lines], command=command_line())
        write_json(args.json, {**runs_document(lines), "provenance": origin})
    if lines:
        print(runs_text(lines))
    if others := other_tables(args.folder):
        print(f"{len(others)} CSV files of other programs: legid import {others[0]} --guess finds their columns")
    print(f"{len(lines)} of {len(every)} runs" if len(lines) < len(every) else f"{len(every)} runs")
    return 0
