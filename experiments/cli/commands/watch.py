"""`legid watch`: runs tested as they arrive: is the rig still what its reference runs say?"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from experiments.cli.arguments import add_force, add_output, add_rig, chosen_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "watch", help="test run after run for a change since the reference runs",
        description="Test every run, in the order given, against earlier runs of the same rig. The test is sequential: "
                    "blocks of 5 s of motion add up until a change is certain. The threshold comes from the false "
                    "alarms per hour that are allowed. After an alarm, two runs name what changed. With --follow the "
                    "command waits for further runs in the folders, such as those that legid record writes, until "
                    "Ctrl-C.")
    parser.add_argument("places", metavar="RUN", nargs="+", help="run files, or folders of them")
    parser.add_argument("--against", metavar="REFERENCE", nargs="+", required=True,
                        help="earlier runs of this rig, folders of them, or the model that legid diagnose wrote of "
                             "them; eight runs or more, with the temperatures that are no change")
    add_rig(parser)
    parser.add_argument("--false-alarms", metavar="PER_HOUR", type=_rate, default=0.1,
                        help="most false alarms per hour of motion (default 0.1)")
    parser.add_argument("--follow", action="store_true", help="wait for further runs, until Ctrl-C")
    add_output(parser, "--json", "legid.watch/1", help="write the result as JSON (schema legid.watch/1)")
    add_output(parser, "--html", "page", help="write a page with a chart over the runs")
    add_force(parser)
    parser.set_defaults(run=run)


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 60.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of false alarms per hour, above 0 and at most 60")
    return value


def run(args: argparse.Namespace) -> int:
    """Test, print a line a run, write what was asked for after each."""
    from daq import InputError
    from experiments.console import command_line, note, warn
    from experiments.provenance import origin_of
    from experiments.reports import line_text, watch_summary
    from experiments.workflows import arrivals, runs_in
    from legid import Watching, load, watch

    models = [path for path in args.against if path.lower().endswith(".json")]
    if models and len(args.against) > 1:
        raise InputError(models[0], "is a model, and is not the only reference", "give one model, or runs alone")
    against = models or runs_in(args.against)
    if models:
        warn(f"{models[0]} holds no runs: the threshold is not checked on left-out runs; give the runs for that")
    chosen = chosen_rig(args, [] if models else against)
    done: list[str] = []
    last: list[Watching] = []
    waiting: list[bool] = []

    def files() -> Iterator[str]:
        waiting.append(args.follow)
        if args.follow:
            note("Waiting for runs; Ctrl-C ends.")
        for file in arrivals(args.places, against, args.follow):
            done.append(file)
            yield file

    def tell(found: Watching) -> None:
        last[:] = [found]
        print(line_text(found.watched[-1]), flush=True)
        found.provenance = origin_of(done, chosen.source, models[0] if models else None, command=command_line())
        if args.json:
            found.to_json(args.json)
        if args.html:
            found.page(args.html)

    try:
        watch(files(), models[0] if models else load(against, chosen.rig, args.damaged), chosen.rig,
              args.false_alarms, args.damaged, tell)
    except KeyboardInterrupt:
        if not args.follow or not waiting:
            raise
    if not last and not args.follow:
        raise InputError(args.places[0], "holds no run but those of the reference", "give later runs")
    if last:
        print(watch_summary(last[0]))
    return 0
