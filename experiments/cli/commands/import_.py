"""`legid import`: files of other programs as runs."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "import", help="files of other programs as runs",
        description="Read CSV of any dialect, MATLAB, Parquet and ROS bags by a map of columns, and write runs as CSV. "
                    "With --guess the map is worked out by names, gravity and the equation of "
                    "motion, shown as a table and as a page, and written: look at it, then import with it. The same "
                    "table as [columns] in a rig.toml lets every command read such files.")
    parser.add_argument("files", metavar="FILE", nargs="+",
                        help=".csv, .txt, .mat, .parquet, .mcap, .db3, or a ROS bag's folder")
    parser.add_argument("--map", metavar="COLUMNS.toml", required=True, help="the map of columns")
    parser.add_argument("--guess", action="store_true", help="write the map, from the first file, and a page beside it")
    parser.add_argument("--out", metavar="DIR", default=".", help="where the runs go; default: here")
    add_force(parser)
    parser.add_argument("--rate", metavar="HZ", type=float, help="samples per second; default: the slowest signal's")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Guess, or read, map and write."""
    from pathlib import Path

    from daq import InputError
    from daq.runs import write_csv
    from experiments.console import make_directory
    from experiments.exchange import apply_map, load_map, read_foreign

    if args.guess:
        return _guess(args)
    if args.rate is not None and not 0.0 < args.rate < 1e6:
        raise InputError("--rate", f"{args.rate:g} is not a rate in Hz", "give samples per second")
    columns = load_map(args.map)
    out = Path(args.out)
    make_directory(out)
    for file in args.files:
        target = out / f"{Path(file).name.split('.')[0]}.csv"
        if target.exists():
            raise InputError(str(target), "exists already", "give another directory with --out")
        data = apply_map(read_foreign(file), columns, args.rate)
        rows = write_csv(data, target)
        print(f"{target}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}")
    return 0


def _guess(args: argparse.Namespace) -> int:
    """Write the map and its page; nothing is imported before somebody has looked at it."""
    import shlex
    import sys
    from pathlib import Path

    from daq import InputError, WorkError
    from experiments.console import text_table, write_text
    from experiments.exchange import guess_map, map_text, read_foreign
    from experiments.reports import GUESS_HEADER, guess_rows, guess_section, guess_verdict, write_page

    target, page = Path(args.map), Path(args.map).with_suffix(".html")
    if target.exists():
        raise InputError(str(target), "exists already", "give another name, or leave --guess out to use it")
    found = guess_map(read_foreign(args.files[0]))
    print(text_table(GUESS_HEADER, guess_rows(found), set()))
    write_text(target, map_text(found.columns, found.notes))
    write_page(page, f"Columns of {Path(args.files[0]).name}", "A guess: look at it before it is used.",
               [guess_section(found, args.files[0])], verdict=guess_verdict(found))
    for warning in [*found.unexplained, *found.warnings]:
        print(f"warning: {warning}", file=sys.stderr)
    if found.unexplained:
        raise WorkError(f"{args.files[0]}: no units and signs explain its columns; {target} is written all the same: "
                        f"correct it, with {page} to judge it by, before you import with it")
    print(f"{target} written, and {page} to judge it by; then:\n"
          f"legid import {shlex.join(args.files)} --map {shlex.quote(str(target))}")
    return 0
