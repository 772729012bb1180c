"""`legid compare`: two models on runs that neither has seen, or the runs of two sessions."""

from __future__ import annotations

import argparse
from pathlib import Path

import legid
from daq import InputError
from experiments import workflows
from legid.cli.answer import answer, chosen_rig, given_runs, refuse
from legid.cli.arguments import DAMAGED, FORCE, HORIZONS, HTML, MOST_WORKERS, RIG, whole_number
from legid.cli.command import Command, argument, one_of, output

COMMAND = Command(
    "compare", "two models on the same runs, or the runs of two sessions",
    "Two models: parameters with intervals and the difference in standard deviations, and free-run errors over "
    "horizons from 0.1 s to whole runs, with an interval for who is better. Use runs that neither model was fitted to. "
    "Two sessions of a rig, or of two rigs of one drawing: whether they differ beyond the scatter of runs within a "
    "session, and by what: parameters, mechanics, sensors, timing, environment or noise. Sizes are those of the second "
    "session less those of the first. Further sessions are each compared with the first.", (
        argument("places", metavar="A", nargs="+",
                 help="two models and runs; or folders, one a session; or the runs of the first session"),
        argument("--with", metavar="RUN", nargs="+", action="append", default=[], dest="others",
                 help="runs of the second session, or its folder; may be repeated for further sessions"),
        RIG, DAMAGED,
        argument("--sensors", choices=("imu", "encoder"),
                 help="of models: what gives the pivot's angle; default: imu where all runs have its columns"),
        HORIZONS,
        one_of(argument("--workers", type=whole_number(1, MOST_WORKERS), metavar="N",
                        help="of three and more sessions: local processes; default: one a core"),
               argument("--cluster", metavar="ADDRESS", help="of sessions: an existing Dask scheduler")),
        output("--json", lambda args: "legid.comparison/1" if _of_models(args) else "legid.sessions/1",
               help="write the result as JSON (schema legid.comparison/1, or legid.sessions/1)"),
        HTML, FORCE),
    usage="legid compare A.json B.json RUN... [options]\n"
          "       legid compare FOLDER_A FOLDER_B [FOLDER...] [options]\n"
          "       legid compare RUN... --with RUN... [--with RUN...] [options]")


def run(args: argparse.Namespace) -> int:
    """Compare models, or sessions."""
    return _models(args) if _of_models(args) else _sessions(args)


def _of_models(args: argparse.Namespace) -> bool:
    return _is_model(args.places[0])


def _is_model(place: str) -> bool:
    return place.lower().endswith(".json")


def _sessions(args: argparse.Namespace) -> int:
    """Raises `WorkError` where no pair could be compared."""
    refuse(args, ("--sensors", "--horizons"), "belongs to a comparison of models")
    places = [args.places, *args.others] if args.others else [[place] for place in args.places]
    for place in () if args.others else args.places:
        if not Path(place).is_dir():
            raise InputError(place, "is neither a model nor a folder of runs",
                             "give A.json B.json RUN..., two folders, or the runs of A --with those of B")
    if len(places) < 2:
        raise InputError(places[0][0], "is the only session", "give a second folder, or its runs by --with")
    files = [workflows.runs_in(own) for own in places]
    chosen = chosen_rig(args, [path for own in files for path in own])
    sessions = [legid.load(own, chosen, args.damaged) for own in files]
    found = legid.compare_sessions(sessions, workflows.session_names(places), chosen, args.workers, args.cluster)
    return answer(args, found, "" if found.failed else str(found))


def _models(args: argparse.Namespace) -> int:
    refuse(args, ("--workers", "--cluster"), "belongs to a comparison of sessions")
    a, *more = args.places
    if len(more) < 2 or not _is_model(more[0]) or args.others:
        raise InputError(a, "is a model and needs a second model and runs after it", "give A.json B.json RUN...")
    b, *paths = more
    names = (Path(a).name, Path(b).name)
    runs, chosen = given_runs(args, paths)
    found = legid.compare(a, b, runs, chosen, args.sensors, (a, b) if names[0] == names[1] else names, args.horizons)
    return answer(args, found, str(found))
