"""`legid watch`: runs tested as they arrive: is the rig still what its reference runs say?"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import legid
from daq import InputError
from experiments import reports, workflows
from experiments.cli.answer import answer, chosen_rig, given_reference
from experiments.cli.arguments import DAMAGED, FORCE, RIG, number
from experiments.cli.command import Command, argument, output
from experiments.console import note, warn

COMMAND = Command(
    "watch", "test run after run for a change since the reference runs",
    "Test every run, in the order given, against earlier runs of the same rig. The test is sequential: blocks of 5 s "
    "of motion add up until a change is certain. The threshold comes from the false alarms per hour that are allowed. "
    "After an alarm, two runs name what changed. With --follow the command waits for further runs in the folders, such "
    "as those that legid record writes, until Ctrl-C.", (
        argument("places", metavar="RUN", nargs="+", help="run files, or folders of them"),
        argument("--against", metavar="REFERENCE", nargs="+", required=True,
                 help="earlier runs of this rig, folders of them, or the model that legid diagnose wrote of them; "
                      "eight runs or more, with the temperatures that are no change"),
        RIG, DAMAGED,
        argument("--false-alarms", metavar="PER_HOUR", default=0.1, help="most false alarms per hour of motion "
                 "(default 0.1)", type=number(lambda rate: 0.0 < rate <= 60.0, "a number of false alarms per hour, "
                                              "above 0 and at most 60")),
        argument("--follow", action="store_true", help="wait for further runs, until Ctrl-C"),
        output("--json", "legid.watch/1", help="write the result as JSON (schema legid.watch/1)"),
        output("--html", "page", help="write a page with a chart over the runs"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Test, and answer after each run."""
    model, against = given_reference(args.against)
    if model:
        warn(f"{model} holds no runs: the threshold is not checked on left-out runs; give the runs for that")
    chosen = chosen_rig(args, against)
    last: list[legid.Watching] = []
    waiting: list[bool] = []

    def files() -> Iterator[str]:
        waiting.append(args.follow)
        if args.follow:
            note("Waiting for runs; Ctrl-C ends.")
        yield from workflows.arrivals(args.places, against, args.follow)

    def tell(found: legid.Watching) -> None:
        last[:] = [found]
        answer(args, found, reports.line_text(found.watched[-1]))

    try:
        reference = model or legid.load(against, chosen, args.damaged)
        legid.watch(files(), reference, chosen, args.false_alarms, args.damaged, tell)
    except KeyboardInterrupt:
        if not args.follow or not waiting:
            raise
    if not last and not args.follow:
        raise InputError(args.places[0], "holds no run but those of the reference", "give later runs")
    if last:
        print(last[0].summary)
    return 0
