"""`legid investigate`: record and diagnose, and record again what the answer lacks."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import MOST_WORKERS, add_rig, whole_number
from experiments.cli.commands.demo import HIDEABLE, parse_seed


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "investigate", help="record, diagnose, and record what separates the rivals, until one cause stands",
        description="Record gentle runs, then the default design, and diagnose. While several causes are possible, "
                    "design the torque that tells them apart, record it and diagnose again. While no listed effect "
                    "explains the error, record another kind of motion. It ends where one cause stands, nothing "
                    "material is left, a further run would not change the answer, or the budget is spent. A person "
                    "confirms every recording of a real leg. The folder gets the runs, a diagnosis a step, the model "
                    "and a journal (investigation.html and .json).")
    add_rig(parser, runs=False)
    parser.add_argument("--budget", metavar="MINUTES", type=_minutes, default=30.0,
                        help="wall time; a step that is not expected to end in it is not begun (default 30)")
    parser.add_argument("--out", metavar="DIR", default="investigation",
                        help="where the files go; a folder without runs (default investigation)")
    parser.add_argument("--yes", action="store_true",
                        help="do not ask before each recording: the leg may move unattended")
    parser.add_argument("--estop-at-hand", action="store_true",
                        help="on a drive other than our own firmware: a hard-wired emergency stop is within reach, so "
                             "do not ask")
    parser.add_argument("--emulate", metavar="NAME", nargs="?", const="none", choices=HIDEABLE,
                        help="investigate an emulated leg of the rig's kind instead, with this hidden in it: "
                             f"{', '.join(HIDEABLE)} (the default)")
    parser.add_argument("--seed", metavar="N", type=parse_seed, default=1,
                        help="of the plans and of the emulated leg's noise; default: 1")
    parser.add_argument("--workers", metavar="N", type=whole_number(1, MOST_WORKERS),
                        help="processes that share a diagnosis; default: one a core")
    parser.set_defaults(run=run)


def _minutes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 1440.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of minutes, above 0 and at most 1440")
    return value


def run(args: argparse.Namespace) -> int:
    """Investigate, tell each step, then the answer."""
    from pathlib import Path

    from daq import WorkError
    from experiments.console import stages
    from experiments.documents import Step
    from experiments.reports import investigation_text, step_text
    from experiments.rig import rig_path
    from legid import investigate

    def tell(step: Step) -> None:
        print(step_text(step), flush=True)

    out = Path(args.out)
    with stages("investigating") as show:
        done = investigate(rig_path(args.rig), out, args.budget, args.emulate, args.seed, args.yes,
                           args.estop_at_hand, args.workers, show, tell)
    print(investigation_text(done))
    print(f"{out / 'investigation.html'}: the journal; {out}: {len(done.runs)} runs")
    if done.ending == "failed":
        raise WorkError(done.why)
    if done.ending == "stopped":
        raise KeyboardInterrupt
    return 0
