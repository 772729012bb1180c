"""`legid investigate`: record and diagnose, and record again what the answer lacks."""

from __future__ import annotations

import argparse
from pathlib import Path

import legid
from experiments import reports, rig
from experiments.cli.answer import answer
from experiments.cli.arguments import ESTOP, HIDEABLE, MOST_WORKERS, RIG_ALONE, SEED, number, whole_number
from experiments.cli.command import Command, argument
from experiments.console import stages

COMMAND = Command(
    "investigate", "record, diagnose, and record what separates the rivals, until one cause stands",
    "Record gentle runs, then the default design, and diagnose. While several causes are possible, design the torque "
    "that tells them apart, record it and diagnose again. While no listed effect explains the error, record another "
    "kind of motion. It ends where one cause stands, nothing material is left, a further run would not change the "
    "answer, or the budget is spent. A person confirms every recording of a real leg. The folder gets the runs, a "
    "diagnosis a step, the model and a journal (investigation.html and .json).", (
        RIG_ALONE,
        argument("--budget", metavar="MINUTES", default=30.0,
                 type=number(lambda minutes: 0.0 < minutes <= 1440.0,
                             "a number of minutes, above 0 and at most 1440"),
                 help="wall time; a step that is not expected to end in it is not begun (default 30)"),
        argument("--out", metavar="DIR", default="investigation",
                 help="where the files go; a folder without runs (default investigation)"),
        argument("--yes", action="store_true", help="do not ask before each recording: the leg may move unattended"),
        ESTOP,
        argument("--emulate", metavar="NAME", nargs="?", const="none", choices=HIDEABLE,
                 help="investigate an emulated leg of the rig's kind instead, with this hidden in it: "
                      f"{', '.join(HIDEABLE)} (the default)"),
        argument("--seed", metavar="N", type=SEED, default=1,
                 help="of the plans and of the emulated leg's noise; default: 1"),
        argument("--workers", metavar="N", type=whole_number(1, MOST_WORKERS),
                 help="processes that share a diagnosis; default: one a core")))


def run(args: argparse.Namespace) -> int:
    """Investigate, tell each step, then the answer."""
    out = Path(args.out)
    with stages("investigating") as show:
        done = legid.investigate(rig.rig_path(args.rig), out, args.budget, args.emulate, args.seed, args.yes,
                                 args.estop_at_hand, args.workers, show,
                                 lambda step: print(reports.step_text(step), flush=True))
    answer(args, done, f"{reports.investigation_text(done)}\n"
                       f"{out / 'investigation.html'}: the journal; {out}: {len(done.runs)} runs")
    if done.ending == "stopped":
        raise KeyboardInterrupt
    return 0
