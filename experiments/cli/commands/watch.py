"""`legid watch`: runs tested as they arrive: is the rig still what its reference runs say?"""

from __future__ import annotations

import argparse

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
    from experiments.console import busy, command_line, note, warn, write_json
    from experiments.judge import Watched
    from experiments.models import load_model
    from experiments.provenance import origin_of, source_of
    from experiments.reports import line_text, watch_document, watch_summary, write_watch
    from experiments.workflows import arrivals, runs_in, watcher_of

    models = [path for path in args.against if path.lower().endswith(".json")]
    if models and len(args.against) > 1:
        raise InputError(models[0], "is a model, and is not the only reference", "give one model, or runs alone")
    against = models or runs_in(args.against)
    if models:
        warn(f"{models[0]} holds no runs: the threshold is not checked on left-out runs; give the runs for that")
    files = arrivals(args.places, against, args.follow)
    chosen = chosen_rig(args, [] if models else against)
    with busy("learning the reference"):
        watcher = watcher_of(load_model(models[0]) if models else against, models[0] if models else "", chosen.rig,
                             args.false_alarms, args.damaged)
    lines: list[Watched] = []
    done: list[str] = []
    sources = tuple(map(source_of, against))
    if args.follow:
        note("Waiting for runs; Ctrl-C ends.")
    try:
        for file in files:
            lines.append(watcher.watch(file))
            done.append(file)
            print(line_text(lines[-1]), flush=True)
            origin = origin_of(done, chosen.source, models[0] if models else None, command=command_line())
            if args.json:
                write_json(args.json, {**watch_document(lines, args.false_alarms, watcher.test.reference.runs, sources),
                                       "provenance": origin})
            if args.html:
                write_watch(args.html, lines, args.false_alarms, origin)
    except KeyboardInterrupt:
        if not args.follow:
            raise
    if not lines and not args.follow:
        raise InputError(args.places[0], "holds no run but those of the reference", "give later runs")
    print(watch_summary(lines, args.false_alarms))
    return 0
