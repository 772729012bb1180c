"""`legid recover`: what is whole in a damaged run file, as a clean one."""

from __future__ import annotations

import argparse
from pathlib import Path

from legid.cli.command import Command, argument, output

COMMAND = Command(
    "recover", "repair a run file that a crash cut short",
    "Write all undamaged parts of RUN to a clean, indexed file. RUN itself is not changed. Other commands also read "
    "the undamaged parts of a cut file.", (
        argument("run_file", metavar="RUN", help="a .mcap run file"),
        output("--out", "run", help="the file to write; default: RUN with .recovered before .mcap")))


def run(args: argparse.Namespace) -> int:
    """Copy what is whole, say what was lost."""
    from daq.runs import recover

    path = Path(args.run_file)
    out = Path(args.out) if args.out else path.with_name(f"{path.stem}.recovered.mcap")
    report = recover(path, out)
    state = "was whole already" if report.complete and not report.damaged_chunks else "was cut off or damaged"
    damaged = f", {report.damaged_chunks} damaged chunks left out" if report.damaged_chunks else ""
    print(f"{path} {state}; {report.messages} messages saved to {out}{damaged}")
    return 0
