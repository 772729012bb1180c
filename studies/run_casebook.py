"""The work of `legid casebook`."""

from __future__ import annotations

import argparse
from pathlib import Path

from daq import InputError
from experiments.console import command_line, progress, write_json
from experiments.provenance import origin_of
from studies.casebook import casebook_document, cases_in, load_cases, study_case
from studies.casebook_page import study_text, write_casebook


def run(args: argparse.Namespace) -> int:
    """Study every case, print a few lines of each, write what was asked for."""
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
