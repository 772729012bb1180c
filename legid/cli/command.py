"""`Command`: what a command is called, says of itself and takes; argparse's parsers are made of it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from daq import InputError

Subparsers = argparse._SubParsersAction
Kind = str | Callable[[argparse.Namespace], str] | None
"""What a file will be, in the words of `daq.files`; None where only the writer knows."""


class Argument(NamedTuple):
    """One argument, as `add_argument` of argparse takes it."""

    flags: tuple[str, ...]
    options: Mapping[str, Any]
    writes: bool = False
    """Whether it names a file to write, which `check_outputs` looks at before the command does its work."""
    kind: Kind = None


class OneOf(NamedTuple):
    """Arguments of which one at most is given."""

    arguments: tuple[Argument, ...]
    required: bool = False


class Command(NamedTuple):
    """A command of `legid`, or a step of one."""

    name: str
    help: str
    description: str
    arguments: tuple[Argument | OneOf, ...] = ()
    usage: str | None = None
    steps: tuple[Command, ...] = ()
    """Of `legid NAME WHAT`; then `what` is the name of the step that was chosen."""
    title: str = ""
    """Heading of the steps."""

    def add_to(self, subparsers: Subparsers[Any]) -> argparse.ArgumentParser:
        """The parser of this command, added to those of the others."""
        parser: argparse.ArgumentParser = subparsers.add_parser(
            self.name, help=self.help, description=self.description, usage=self.usage)
        for part in self.arguments:
            place = parser.add_mutually_exclusive_group(required=part.required) if isinstance(part, OneOf) else parser
            actions = [(one, place.add_argument(*one.flags, **one.options)) for one in _each(part)]
            parser.set_defaults(outputs=(*(parser.get_default("outputs") or ()), *(
                (action.dest, one.kind) for one, action in actions if one.writes)))
        if self.steps:
            below = parser.add_subparsers(title=self.title, metavar="WHAT", required=True, dest="what")
            for step in self.steps:
                step.add_to(below)
        return parser


def argument(*flags: str, **options: Any) -> Argument:
    """An argument like that of `add_argument`."""
    return Argument(flags, options)


def output(flag: str, kind: Kind, metavar: str = "FILE", **options: Any) -> Argument:
    """An argument that names a file to write."""
    return Argument((flag,), {"metavar": metavar, **options}, True, kind)


def one_of(*arguments: Argument, required: bool = False) -> OneOf:
    """Arguments that exclude each other."""
    return OneOf(arguments, required)


def _each(part: Argument | OneOf) -> tuple[Argument, ...]:
    return part.arguments if isinstance(part, OneOf) else (part,)


def check_outputs(args: argparse.Namespace) -> None:
    """Raises `InputError` where a file to write may not go where it was asked to, or two are to go to one place."""
    from pathlib import Path

    from daq import check_place, kind_of

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
