"""`legid casebook`: case studies on public records."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force, add_output


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "casebook", help="put public records through fit, validate and diagnose",
        description="For each known folder of public records under DIR: fit, validate and diagnose with the rig file "
                    "shipped for it, and compare the results with the published ones on one page.")
    parser.add_argument("folder", metavar="DIR", help="the directory that holds the folders")
    add_output(parser, "--html", "page", help="write the page")
    add_output(parser, "--json", "legid.casebook/1", help="write the figures as JSON (schema legid.casebook/1)")
    add_force(parser)
    parser.add_argument("--only", metavar="FOLDER", action="append", default=[],
                        help="this folder alone; may be repeated")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Study every case, print a few lines of each, write what was asked for."""
    from pathlib import Path

    from daq import InputError
    from experiments.console import command_line, progress, write_json
    from experiments.provenance import origin_of
    from experiments.studies import casebook_document, cases_in, load_cases, study_case, study_text, write_casebook

    cases = load_cases()
    folders = [case.folder for case in cases]
    unknown = [name for name in args.only if name not in folders]
    if unknown:
        raise InputError("--only", f"no case is known for {unknown[0]}", "it has " + ", ".join(folders))
    wanted = [case for case in cases if not args.only or case.folder in args.only]
    studies = []
    for case in progress(cases_in(Path(args.folder), wanted), "studying", unit="case"):
        studies.append(study_case(case, Path(args.folder)))
        print(study_text(studies[-1]), flush=True)
    if args.json:
        records = [path for study in studies for path in sorted(Path(args.folder, study.case.folder).rglob("*"))
                   if path.is_file()]
        write_json(args.json, {**casebook_document(studies), "provenance": origin_of(records, command=command_line())})
    if args.html:
        write_casebook(args.html, studies)
    return 0
