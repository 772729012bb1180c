"""`legid import`: files of other programs as runs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

from experiments.cli.arguments import add_force


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "import", help="files of other programs as runs",
        description="Read CSV of any dialect, MATLAB, HDF5, NumPy, PyTorch, pickle, JSON, Parquet and ROS bags "
                    "by a map of columns, and write runs as CSV. A file that cannot be read is named, and the others "
                    "are imported. "
                    "With --guess the map is worked out by names, gravity and the equation of "
                    "motion, shown as a table and as a page, and written: look at it, then import with it. The same "
                    "table as [columns] in a rig.toml lets every command read such files.")
    parser.add_argument("files", metavar="FILE", nargs="+",
                        help=".csv, .txt, .mat, .npz, .h5, .pt, .pkl, .json, .parquet, .mcap, .db3, or a bag's folder")
    parser.add_argument("--map", metavar="COLUMNS.toml", required=True, help="the map of columns")
    parser.add_argument("--guess", action="store_true",
                        help="write a map guessed from the first file, and a page next to it")
    parser.add_argument("--out", metavar="DIR", default=".", help="where the runs go; default: here")
    add_force(parser)
    parser.add_argument("--rate", metavar="HZ", type=float, help="samples per second; default: the slowest signal's")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Guess, or read, map and write; a file that cannot be read does not stop the others."""
    import sys

    from daq import InputError
    from daq.runs import write_csv
    from experiments.console import make_directory, printable, warn
    from experiments.exchange import apply_map, load_map, read_imported, runs_in

    if args.guess:
        return _guess(args)
    if args.rate is not None and not 0.0 < args.rate < 1e6:
        raise InputError("--rate", f"{args.rate:g} is not a rate in Hz", "give samples per second")
    columns = load_map(args.map)
    out = Path(args.out)
    make_directory(out)
    given = {Path(file).resolve() for file in args.files}
    bad = 0
    for file, target in _targets(args.files, out):
        try:
            imported = read_imported(file)
            for ending, own in runs_in(imported, columns):
                place = target.with_name(f"{target.stem}{ending}.csv")
                if place.resolve() in given:
                    raise InputError(str(place), "exists already", "give another directory with --out")
                data = apply_map(imported, own, args.rate)
                rows = write_csv(data, place, replace=args.force)
                print(f"{place}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}")
                for flag in data.flags:
                    warn(f"{file} {flag}")
        except InputError as error:
            if len(args.files) == 1:
                raise
            print(f"legid import: {printable(str(error))}", file=sys.stderr)
            bad += 1
    if bad:
        raise InputError("", f"{bad} of {len(args.files)} files not imported", "the others are written")
    return 0


def _targets(files: list[str], out: Path) -> Iterator[tuple[str, Path]]:
    """(file, where its run goes): its name, and its folder's before it where two have one name."""
    names = [re.sub(r"(\.csv)?\.[^.]*$", "", Path(file).name) for file in files]
    for file, name in zip(files, names):
        folder = f"{Path(file).resolve().parent.name}-" if names.count(name) > 1 else ""
        yield file, out / f"{folder}{name}.csv"


def _guess(args: argparse.Namespace) -> int:
    """Write the map and its page; nothing is imported before somebody has looked at it."""
    import shlex
    import sys

    from daq import InputError, WorkError, write_file
    from experiments.console import text_table
    from experiments.exchange import guess_map, guess_text, is_guess, read_imported
    from experiments.reports import GUESS_HEADER, guess_rows, guess_section, guess_verdict, write_page

    target, page = Path(args.map), Path(args.map).with_suffix(".html")
    if target.exists() and not (args.force or is_guess(target)):
        raise InputError(str(target), "exists already, and was changed by hand",
                         "leave --guess out to import by it, or give --force to write it anew")
    found = guess_map(read_imported(args.files[0]))
    print(text_table(GUESS_HEADER, guess_rows(found), set()))
    write_file(target, guess_text(found.columns, found.notes).encode(), changed=True)
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
