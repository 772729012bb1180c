"""`legid casebook`: case studies on public records."""

from __future__ import annotations

import argparse

from legid.cli.arguments import FORCE
from legid.cli.command import Command, argument, output
from legid.cli.source_tree import study

COMMAND = Command(
    "casebook", "put public records through fit, validate and diagnose",
    "For each known folder of public records under DIR: fit, validate and diagnose with the rig file shipped for it, "
    "and compare the results with the published ones on one page. It needs legid's source tree.", (
        argument("folder", metavar="DIR", help="the directory that holds the folders"),
        output("--html", "page", help="write the page"),
        output("--json", "legid.casebook/1", help="write the figures as JSON (schema legid.casebook/1)"),
        FORCE,
        argument("--only", metavar="FOLDER", action="append", default=[],
                 help="this folder alone; may be repeated")))


def run(args: argparse.Namespace) -> int:
    """Run the study."""
    return study("run_casebook")(args)
