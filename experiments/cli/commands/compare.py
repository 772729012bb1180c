"""`legid compare`: two models on runs that neither has seen, or the runs of two sessions."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import (
    MOST_WORKERS,
    add_force,
    add_horizons,
    add_output,
    add_rig,
    chosen_rig,
    whole_number,
)

MODEL = ".json"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "compare", help="two models on the same runs, or the runs of two sessions",
        usage="legid compare A.json B.json RUN... [options]\n"
              "       legid compare FOLDER_A FOLDER_B [FOLDER...] [options]\n"
              "       legid compare RUN... --with RUN... [--with RUN...] [options]",
        description="Two models: parameters with intervals and the difference in standard deviations, and free-run "
                    "errors over horizons from 0.1 s to whole runs, with an interval for who is better. Use runs that "
                    "neither model was fitted to. Two sessions of a rig, or of two rigs of one drawing: whether they "
                    "differ beyond the scatter of runs within a session, and by what: parameters, mechanics, sensors, "
                    "timing, environment or noise. Sizes are those of the second session less those of the first. "
                    "Further sessions are each compared with the first.")
    parser.add_argument("places", metavar="A", nargs="+",
                        help="two models and runs; or folders, one a session; or the runs of the first session")
    parser.add_argument("--with", metavar="RUN", nargs="+", action="append", default=[], dest="others",
                        help="runs of the second session, or its folder; may be repeated for further sessions")
    add_rig(parser)
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="of models: what gives the pivot's angle; default: imu where all runs have its columns")
    add_horizons(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=whole_number(1, MOST_WORKERS), metavar="N",
                       help="of three and more sessions: local processes; default: one a core")
    where.add_argument("--cluster", metavar="ADDRESS", help="of sessions: an existing Dask scheduler")
    add_output(parser, "--json", lambda args: "legid.comparison/1" if _of_models(args) else "legid.sessions/1",
               help="write the result as JSON (schema legid.comparison/1, or legid.sessions/1)")
    add_output(parser, "--html", "page", help="write a report page")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compare, print, write what was asked for."""
    return _compare_models(args) if _of_models(args) else _compare_sessions(args)


def _of_models(args: argparse.Namespace) -> bool:
    return str(args.places[0]).lower().endswith(MODEL)


def _compare_sessions(args: argparse.Namespace) -> int:
    """Say how sessions differ. Raises `WorkError` where no pair could be compared."""
    from pathlib import Path

    from daq import InputError, WorkError
    from experiments.console import command_line
    from experiments.provenance import origin_of
    from experiments.workflows import runs_in, session_names
    from legid import compare_sessions, load

    for option, given in (("--sensors", args.sensors), ("--horizons", args.horizons)):
        if given:
            raise InputError(option, "belongs to a comparison of models", "leave it out")
    places = [args.places, *args.others] if args.others else [[place] for place in args.places]
    for (place, *_), alone in zip(places, (not args.others,) * len(places)):
        if alone and not Path(place).is_dir():
            raise InputError(place, "is neither a model nor a folder of runs",
                             "give A.json B.json RUN..., two folders, or the runs of A --with those of B")
    if len(places) < 2:
        raise InputError(places[0][0], "is the only session", "give a second folder, or its runs by --with")
    names, files = session_names(places), [runs_in(own) for own in places]
    every = [path for own in files for path in own]
    chosen = chosen_rig(args, every)
    origin = origin_of(every, chosen.source, command=command_line())
    sessions = [load(own, chosen.rig, args.damaged) for own in files]
    found = compare_sessions(sessions, names, chosen.rig, args.workers, args.cluster)
    found.provenance = origin
    if any(pair.verdict != "fit_failed" for pair in found.pairs):
        print(found, flush=True)
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html)
    if all(pair.verdict == "fit_failed" for pair in found.pairs):
        raise WorkError(found.pairs[0].sentence)
    return 0


def _compare_models(args: argparse.Namespace) -> int:
    from pathlib import Path

    from daq import InputError
    from experiments.console import command_line
    from experiments.models import load_model
    from experiments.provenance import origin_of
    from legid import compare, load

    for option, given in (("--workers", args.workers), ("--cluster", args.cluster)):
        if given:
            raise InputError(option, "belongs to a comparison of sessions", "leave it out")
    if len(args.places) < 3 or not args.places[1].lower().endswith(MODEL) or args.others:
        raise InputError(args.places[0], "is a model and needs a second model and runs after it",
                         "give A.json B.json RUN...")
    args.runs = args.places[2:]
    paths = args.places[0], args.places[1]
    models = load_model(paths[0]), load_model(paths[1])
    rig = chosen_rig(args, args.runs)
    origin = origin_of(args.runs, rig.source, models=paths, command=command_line())
    runs = load(args.runs, rig.rig, args.damaged)
    files = (Path(paths[0]).name, Path(paths[1]).name)
    found = compare(*models, runs, rig.rig, args.sensors, paths if files[0] == files[1] else files, args.horizons)
    found.provenance = origin
    print(found)
    if args.json:
        found.to_json(args.json)
    if args.html:
        found.page(args.html)
    return 0
