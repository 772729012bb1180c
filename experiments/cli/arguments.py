"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from experiments.rig import ChosenRig

MOST_WORKERS = 1024
Kind = str | Callable[[argparse.Namespace], str] | None
"""What a file will be, in the words of `daq.files`; None where only the writer knows."""


def add_output(parser: argparse._ActionsContainer, flag: str, kind: Kind, metavar: str = "FILE",
               **options: object) -> None:
    """An argument that names a file to write, which `check_outputs` looks at before the command does its work."""
    action = parser.add_argument(flag, metavar=metavar, **options)  # type: ignore[arg-type]
    parser.set_defaults(outputs=(*(parser.get_default("outputs") or ()), (action.dest, kind)))


def add_verbosity(parser: argparse.ArgumentParser) -> None:
    """`--quiet` and `--verbose`, for a command and those below it."""
    from experiments.console import QUIET, VERBOSE

    how = parser.add_mutually_exclusive_group()
    how.add_argument("--quiet", dest="verbosity", action="store_const", const=QUIET, default=argparse.SUPPRESS,
                     help="no progress and no notes, only results, warnings and errors")
    how.add_argument("--verbose", dest="verbosity", action="store_const", const=VERBOSE, default=argparse.SUPPRESS,
                     help="also what was read and how long it took")
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                add_verbosity(below)


def add_rig(parser: argparse.ArgumentParser, runs: bool = True) -> None:
    """`--rig`, and `--damaged` for a command that reads runs."""
    held = "the one that a run holds, else " if runs else ""
    parser.add_argument("--rig", help=f"the rig's TOML file; default: {held}./rig.toml")
    if runs:
        parser.add_argument("--damaged", action="store_true",
                            help="use runs of whose files something is missing, too; the documents say which")


def chosen_rig(args: argparse.Namespace, runs: Sequence[str]) -> ChosenRig:
    """The rig that the command goes by, told of where nobody gave it."""
    from experiments.console import note
    from experiments.rig import choose_rig

    chosen = choose_rig(args.rig, runs)
    if chosen.note:
        note(chosen.note)
    return chosen


def add_horizons(parser: argparse.ArgumentParser) -> None:
    """`--horizons`, None where it was not given."""
    parser.add_argument("--horizons", type=seconds, metavar="S,S,...",
                        help="lengths of the pieces that are simulated [s], besides whole runs; default: 0.1,0.5,1,5")


def seconds(text: str) -> tuple[float, ...]:
    """A reader of lengths of time [s], by commas."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = (0.0,)
    if not all(0.0 < value < float("inf") for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not lengths of time in seconds, such as 0.25,1")
    return values


def assignment(text: str) -> tuple[str, float]:
    """NAME=VALUE."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE") from None


def add_fix(parser: argparse.ArgumentParser) -> None:
    """`--fix`."""
    parser.add_argument("--fix", metavar="NAME=VALUE", action="append", default=[], type=assignment,
                        help="give a parameter instead of estimating it, e.g. --fix beta8=0; may be repeated")


def add_force(parser: argparse.ArgumentParser) -> None:
    """`--force`."""
    parser.add_argument("--force", action="store_true",
                        help="replace a file that is there even where it is of another kind; a run never")


def check_outputs(args: argparse.Namespace) -> None:
    """Raises `InputError` where a file to write may not go where it was asked to, or two are to go to one place."""
    from pathlib import Path

    from daq import InputError, check_place, kind_of

    seen: dict[Path, str] = {}
    for dest, kind in getattr(args, "outputs", ()):
        path = getattr(args, dest)
        if path is None:
            continue
        flag = f"--{dest.replace('_', '-')}"
        other = seen.setdefault(Path(path).resolve(), flag)
        if other != flag and not str(path).startswith("/dev/"):
            raise InputError(flag, f"{path} is what {other} names too", "give two names")
        wanted = kind(args) if callable(kind) else kind
        check_place(path, wanted if wanted is not None else kind_of(path) or "")


def whole_number(low: int, high: int) -> Callable[[str], int]:
    """A reader of whole numbers from `low` to `high`, for `type=` of an argument."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
        return int(text)

    return read


def share(text: str) -> float:
    """A reader of shares between 0 and 1, both left out."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share between 0 and 1, such as 0.1")
    return value
