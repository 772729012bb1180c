"""`legid tune`: the set-up of a rig from its own records."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_fix, add_force, add_output, add_rig, chosen_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "tune", help="choose a rig's set-up by its records",
        description="Choose grid, hold, filter, encoder error and zeros, rotor and offset terms and friction smoothing "
                    "velocity by cross-validation. A value is chosen if a fit to half of the runs predicts the other "
                    "half better with it. Entries of rig.toml outside [sampling] are kept. "
                    "Exit status 1 when no fit predicts; nothing is chosen then.")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
    add_rig(parser)
    parser.add_argument("--sensors", choices=("imu", "encoder"),
                        help="what gives the pivot's angle; default: imu where all runs have its columns")
    add_fix(parser)
    parser.add_argument("--write", action="store_true", help="put what was chosen into the rig file, comments kept")
    add_output(parser, "--json", "legid.tuning/1", help="write what was chosen and tried as JSON")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Choose, print, write what was asked for."""
    from experiments.console import command_line, note, stages
    from experiments.provenance import origin_of
    from experiments.rig import rig_path
    from experiments.workflows import write_choices
    from legid import tune

    where = rig_path(args.rig) if args.write else None
    chosen = chosen_rig(args, args.runs)
    with stages("tuning") as show:
        found = tune(args.runs, chosen.rig, args.sensors, args.damaged, show, dict(args.fix))
    print(found)
    if args.json:
        found.provenance = origin_of(args.runs, chosen.source, command=command_line())
        found.to_json(args.json)
    if where is not None and found.chosen:
        write_choices(found.chosen, where)
        note(f"{where}: {', '.join(f'[{c.table}] {c.key}' for c in found.chosen)} written")
    elif found.chosen:
        print("next: the same command with --write puts these entries into the rig file")
    return 0 if found.predicts else 1
