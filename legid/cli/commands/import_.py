"""`legid import`: files of other programs as runs."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Iterator, Mapping
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import legid
from daq import InputError, WorkError
from experiments import exchange
from experiments.console import make_directory, printable, text_table, warn
from legid.cli.arguments import AS_READ, FORCE, numbers
from legid.cli.command import Command, argument

if TYPE_CHECKING:
    from daq import Column, Dataset

WHOLE = ".13g"
"""A time since 1970 to the millisecond."""


COMMAND = Command(
    "import", "files of other programs as runs",
    "Read CSV of any dialect, MATLAB, HDF5, NumPy, JSON, Parquet and ROS bags by a map of columns, and write runs as "
    "CSV. A file that cannot be read is named, and the others are imported. Without --map legid guesses the map by "
    "names, gravity and the equation of motion. It shows what it found in each file, writes the map and a page, and "
    "asks whether to import. --guess does the same and imports nothing. The same table as [columns] in a rig.toml lets "
    "every command read such files.", (
        argument("files", metavar="FILE", nargs="+",
                 help=".csv, .txt, .mat, .npz, .h5, .json, .parquet, .mcap, .db3, or a bag's folder"),
        argument("--map", metavar="COLUMNS.toml",
                 help="the map of columns; default: columns.toml in DIR, guessed anew until it is edited"),
        argument("--guess", action="store_true",
                 help="write a map guessed from the first file, and a page next to it"),
        argument("--out", metavar="DIR", default=".", help="where the runs go; default: here"),
        argument("--yes", action="store_true", help="import by a guessed map without asking"),
        FORCE, AS_READ,
        argument("--rate", metavar="HZ", type=float,
                 help="samples per second, which a file without times needs; default: the slowest signal's"),
        argument("--joints", metavar="A,B", type=lambda text: tuple(filter(None, text.split(","))), default=(),
                 help="of a file with many joints, those that a guess takes: by name or by number from 1"),
        argument("--span", metavar="FROM,TO",
                 type=numbers(lambda some: len(some) == 2 and -inf < some[0] < some[1] < inf,
                              "FROM,TO in seconds, such as 50,66"),
                 help="import these seconds of each file alone, by its own clock")))


def run(args: argparse.Namespace) -> int:
    """Guess, or read, map and write; a file that cannot be read does not stop the others."""
    from daq.runs import write_csv

    if args.rate is not None and not 0.0 < args.rate < 1e6:
        raise InputError("--rate", f"{args.rate:g} is not a rate in Hz", "give samples per second")
    out = Path(args.out)
    make_directory(out)
    place = out / "columns.toml" if args.map is None else Path(args.map)
    if args.guess or (args.map is None and (not place.exists() or exchange.is_guess(place))):
        _guess(args, place)
        if args.guess or (not args.yes and not _agreed(args.files, place)):
            _show_next(args, place)
            return 0
    elif args.map is None:
        print(f"map: {place}")
    columns = exchange.load_map(place)
    exchange.require_scales(columns, str(place))
    given = {Path(file).resolve() for file in args.files}
    bad = 0
    for file, target in _targets(args.files, out):
        try:
            imported = exchange.read_imported(file)
            for ending, own in exchange.runs_in(imported, columns):
                written = target.with_name(f"{target.stem}{ending}.csv")
                if written.resolve() in given:
                    raise InputError(str(written), "exists already", "give another directory with --out")
                data = _cut(exchange.apply_map(imported, own, args.rate, args.as_read), args.span)
                rows = write_csv(data, written, replace=args.force)
                print(f"{written}: {rows} samples at {data.rate_hz:g} Hz, columns time_s, {', '.join(data.columns)}")
                for flag in data.told:
                    warn(f"{file} {flag}")
        except InputError as error:
            if len(args.files) == 1:
                raise
            print(f"legid import: {printable(str(error))}", file=sys.stderr)
            bad += 1
    if bad:
        raise InputError("", f"{bad} of {len(args.files)} files not imported", "the others are written")
    return 0


def _cut(data: Dataset, wanted: tuple[float, float] | None) -> Dataset:
    """The samples of the wanted seconds, or all. Raises `InputError` where there is none."""
    if wanted is None:
        return data
    first, last = data.time_s.searchsorted([wanted[0], wanted[1]])
    if first == last:
        start, end, begins, ends = (f"{t:{WHOLE}}" for t in (*wanted, data.time_s[0], data.time_s[-1]))
        raise InputError(data.name, f"has no sample between {start} and {end} s",
                         f"it goes from {begins} to {ends} s: give --span within that")
    return data.part(slice(int(first), int(last)))


def _targets(files: list[str], out: Path) -> Iterator[tuple[str, Path]]:
    """(file, where its run goes): its name, and its folder's before it where two have one name."""
    names = [re.sub(r"(\.csv)?\.[^.]*$", "", Path(file).name) for file in files]
    for file, name in zip(files, names):
        folder = f"{Path(file).resolve().parent.name}-" if names.count(name) > 1 else ""
        yield file, out / f"{folder}{name}.csv"


def _guess(args: argparse.Namespace, target: Path) -> None:
    """Show what the files hold, and write the guessed map to `target` and its page next to it."""
    page = target.with_suffix(".html")
    if target.exists() and not (args.force or exchange.is_guess(target)):
        raise InputError(str(target), "exists already, and was changed by hand",
                         "leave --guess out to import by it, or give --force to write it anew")
    found = legid.Guess(exchange.guess_map(exchange.read_imported(args.files[0]), rate_hz=args.rate,
                                           joints=args.joints), args.files[0])
    print(found.table.text)
    print(text_table(["file", "samples", "rate [Hz]", "length [s]", "missing [%]", "remark"],
                     [_summary(file, found.columns, args.rate) for file in args.files], {1, 2, 3, 4}))
    found.write(target)
    found.page(page)
    for warning in (*found.unexplained, *found.warnings):
        warn(warning)
    if found.unexplained:
        raise WorkError(f"{args.files[0]}: no units and signs explain its columns; {target} is written all the same: "
                        f"correct it, with {page} to judge it by, before you import with it")
    print(f"{target} written, and {page} to judge it by")


def _summary(file: str, columns: Mapping[str, Column], rate_hz: float | None) -> list[str]:
    """Row of a table: samples, rate, length and share of missing samples of one file, read by the guessed map."""
    try:
        imported = exchange.read_imported(file)
        some = exchange.runs_in(imported, columns)
        data = exchange.apply_map(imported, some[0][1], rate_hz)
    except InputError as error:
        return [file, "", "", "", "", error.what]
    wrong = f"{len(imported.wrong)} wrong cells or rows left out" if imported.wrong else ""
    wrong = "; ".join(filter(None, [f"the first of {len(some)} runs" if len(some) > 1 else "", wrong]))
    return [file, str(len(data)), f"{data.rate_hz:g}", f"{len(data) / data.rate_hz:.1f}",
            f"{100.0 * float(data.gap().mean()):.1f}", wrong]


def _agreed(files: list[str], target: Path) -> bool:
    """Whether a person at the terminal says yes to an import by the guessed map."""
    if not sys.stdin.isatty():
        return False
    return input(f"Import {len(files)} files by {target}? [y/N] ").strip().lower() in ("y", "yes")


def _show_next(args: argparse.Namespace, target: Path) -> None:
    """Print the command that imports by the guessed map; a CSV that lies here already needs another directory."""
    there = any(Path(file).suffix == ".csv" and Path(file).resolve().parent == Path(args.out).resolve()
                for file in args.files)
    where = "runs" if there else args.out
    out = "" if where == "." else f" --out {shlex.quote(where)}"
    rate = "" if args.rate is None else f" --rate {args.rate:g}"
    lacking = exchange.unscaled(exchange.load_map(target))
    if lacking:
        print(f"first write scale = N m per {lacking[1]}, gear included, under [columns.{lacking[0]}] in {target}")
    print(f"then: legid import {shlex.join(args.files)} --map {shlex.quote(str(target))}{rate}{out}")
