"""`legid casebook`: case studies on public records."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output
from experiments.cli.source_tree import study


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "casebook", help="put public records through fit, validate and diagnose",
        description="For each known folder of public records under DIR: fit, validate and diagnose with the rig file "
                    "shipped for it, and compare the results with the published ones on one page. It needs legid's "
                    "source tree.")
    parser.add_argument("folder", metavar="DIR", help="the directory that holds the folders")
    add_output(parser, "--html", "page", help="write the page")
    add_output(parser, "--json", "legid.casebook/1", help="write the figures as JSON (schema legid.casebook/1)")
    add_force(parser)
    parser.add_argument("--only", metavar="FOLDER", action="append", default=[],
                        help="this folder alone; may be repeated")
    parser.set_defaults(run=lambda args: study("run_casebook")(args))
