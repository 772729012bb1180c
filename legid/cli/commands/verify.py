"""`legid verify`: are the files behind a result still what they were?"""

from __future__ import annotations

import argparse
from pathlib import Path

from daq import InputError, WorkError
from experiments.console import text_table
from legid.cli.command import Command, argument

COMMAND = Command(
    "verify", "check the files that a JSON, model or report was made from",
    "Compare runs, rig file and model with the SHA-256 sums in FILE. The files are looked for in its folder and in the "
    "folders given. Exit status 1 when one has changed or is missing.", (
        argument("file", metavar="FILE", help="a JSON, a MODEL.json or a report page of legid"),
        argument("folders", metavar="DIR", nargs="*",
                 help="where to look, folders below included; default: FILE's own and the current folder")))


def run(args: argparse.Namespace) -> int:
    """Compare, one line a file."""
    from experiments.provenance import read_origin, verify

    origin = read_origin(args.file)
    folders = [Path(folder) for folder in args.folders] or [Path(args.file).parent, Path()]
    for folder in folders:
        if not folder.is_dir():
            raise InputError(str(folder), "is no folder", "name one that holds the runs")
    checked = verify(origin, folders, args.file)
    print(f"{args.file}: made by legid {origin.version}, commit {origin.commit}")
    rows = [[c.state, c.source.file + (f" in {c.source.inside}" if c.source.inside else ""), c.source.sha256[:16],
             c.where or "-"] for c in checked]
    print(text_table(["state", "file", "SHA-256", "found"], rows, set()))
    bad = [c for c in checked if c.state != "same"]
    if bad:
        raise WorkError(f"{len(bad)} of {len(checked)} files are not what {args.file} was made from: "
                        + ", ".join(f"{c.source.file} ({c.state})" for c in bad))
    return 0
