"""`legid`: the command line. One line for every way it can end badly, never a traceback."""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, NoReturn

from daq import InputError, WorkError, did_you_mean, replacing_anything
from drivers import DriverError
from estimator import FitError
from experiments.console import QUIET, USUAL, VERBOSE, PlainOutput, commanded, detail, printable, verbosity
from legid.cli.command import check_outputs

GROUPS = {
    "set up": ("init", "doctor", "calibrate", "demo", "emulate"),
    "record": ("excite", "record", "live", "info", "runs", "recover", "import_", "export"),
    "model": ("fit", "tune", "validate", "compare", "diagnose", "effects"),
    "use": ("simulate",),
    "check the program": ("verify", "casebook", "monte_carlo")}
"""Heading of `legid --help` -> modules of the folder in their order; others come last, under MORE."""
MORE = "more"
TRACEBACK = "LEGID_TRACEBACK"
"""Environment variable under which an unexpected error keeps its traceback, for debugging."""

EPILOG = """\
a first session:
  legid demo                                   everything on an emulated rig; no hardware needed
  legid info demo-out/demo-run1.mcap           what a run file holds
  legid fit demo-out/demo-run1.mcap demo-out/demo-run2.mcap --rig demo-out/rig.toml --model-out model.json
  legid validate model.json demo-out/demo-run3.mcap --rig demo-out/rig.toml --html validation.html

RUN is a .mcap, .csv or .csv.gz file; RIG is the rig.toml that describes the leg (see docs/rig.md).
`legid COMMAND --help` explains one command.
exit status: 0 done, 1 could not be done on this data, 2 bad arguments or bad input
"""


class Words(argparse.HelpFormatter):
    """Lines of help end at spaces alone, so that no option is parted at a hyphen."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False, break_long_words=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(indent + line for line in self._split_lines(text, width - len(indent)))


class Parser(argparse.ArgumentParser):
    """argparse, with errors of one line that name what was probably meant."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"formatter_class": Words, **settings})

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Arguments by argparse, with a suggestion for an unknown option."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            command = self._commands().get(getattr(found, "command", ""), self)
            known = [option for option in command._option_string_actions if option.startswith("--")]
            self.error(f"unrecognized arguments: {' '.join(unknown)}{did_you_mean(unknown[0].split('=')[0], known)}")
        return found

    def _commands(self) -> dict[str, Any]:
        return next((dict(a.choices) for a in self._actions if isinstance(a, argparse._SubParsersAction)), {})

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = [str(choice) for choice in action.choices]
            hint = did_you_mean(str(value), names)
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}" + (
                hint or f" (choose from {', '.join(map(repr, names))})"))

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def build_parser() -> Parser:
    """The whole command line."""
    parser = Parser(prog="legid", description="Identify a real 2-link robot leg, and say what its model gets wrong.",
                    epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action=_Version)
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="command")
    folder = Path(__file__).parent / "commands"
    there = {info.name for info in iter_modules([str(folder)])}
    others = there - {name for names in GROUPS.values() for name in names}
    for heading, names in {**GROUPS, MORE: tuple(sorted(others))}.items():
        before = len(subparsers._choices_actions)
        for name in names:
            module = import_module(f"legid.cli.commands.{name}")
            add_verbosity(module.COMMAND.add_to(subparsers)).set_defaults(run=module.run)
        if names:
            line = subparsers._ChoicesPseudoAction(f"\n  {heading}:", (), None)
            subparsers._choices_actions.insert(before, line)
    return parser


def add_verbosity(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """`parser` with `--quiet` and `--verbose`, for a command and those below it."""
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--quiet", dest="verbosity", action="store_const", const=QUIET, default=argparse.SUPPRESS,
                     help="no progress and no notes, only results, warnings and errors")
    how.add_argument("--verbose", dest="verbosity", action="store_const", const=VERBOSE, default=argparse.SUPPRESS,
                     help="also what was read and how long it took")
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                add_verbosity(below)
    return parser


class _Version(argparse.Action):
    """`--version`; asks the installation only when wanted."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from experiments.provenance import program_version

        print(f"legid {program_version()}")
        parser.exit(0)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 not possible on this data, 2 bad input."""
    name = "legid"
    try:
        args = build_parser().parse_args(argv)
        name = f"legid {args.command}"
        with replacing_anything(getattr(args, "force", False)), verbosity(getattr(args, "verbosity", USUAL)):
            started = time.monotonic()
            check_outputs(args)
            with redirect_stdout(PlainOutput(sys.stdout)), commanded(sys.argv[1:] if argv is None else argv):
                status = int(args.run(args))
            detail(f"{name}: {time.monotonic() - started:.1f} s")
        sys.stdout.flush()
        return status
    except SystemExit as ending:
        return ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    except InputError as error:
        return _fail(name, error, 2)
    except (WorkError, FitError, DriverError) as error:
        return _fail(name, error, 1)
    except KeyboardInterrupt:
        return _fail(name, "interrupted", 1)
    except BrokenPipeError:
        # Whoever read the output has left (`legid info x | head`); nothing may be flushed into the pipe now.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError:
        return _fail(name, "no memory is left; close other programs, or give less at a time", 1)
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        return _fail(name, f"internal error, please report it: {type(error).__name__}: {error} "
                           f"(set {TRACEBACK}=1 to see where)", 1)


def _fail(name: str, error: object, status: int) -> int:
    print(f"{name}: {printable(' '.join(str(error).split()))}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
