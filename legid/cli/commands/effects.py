"""`legid effects`: what a diagnosis can name."""

from __future__ import annotations

import argparse

import legid
from legid.cli.answer import answer
from legid.cli.arguments import FORCE
from legid.cli.command import Command, output

COMMAND = Command(
    "effects", "list the effects that a diagnosis can name",
    "Every effect in the library with its meaning, the units of its sizes, where its form comes from and the "
    "experiment that shows it best; effects of installed packages (entry point group legid.effects) with them; and "
    "what cannot be tested, with the reason.", (
        output("--json", "legid.effects/1", help="write the list as JSON (schema legid.effects/1)"), FORCE))


def run(args: argparse.Namespace) -> int:
    """Tell the library."""
    found = legid.effects()
    return answer(args, found, str(found))
