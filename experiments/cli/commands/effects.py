"""`legid effects`: what a diagnosis can name."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "effects", help="list the effects that a diagnosis can name",
        description="Every effect in the library with its meaning, the units of its sizes, where its form comes from "
                    "and the experiment that shows it best; effects of installed packages (entry point group "
                    "legid.effects) with them; and what cannot be tested, with the reason.")
    add_output(parser, "--json", "legid.effects/1", help="write the list as JSON (schema legid.effects/1)")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the library, write what was asked for."""
    from experiments.console import command_line, write_json
    from experiments.models import effects_document, effects_text
    from experiments.provenance import origin_of

    print(effects_text())
    if args.json:
        write_json(args.json, {**effects_document(), "provenance": origin_of(command=command_line())})
    return 0
