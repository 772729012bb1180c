"""`legid tune`: the set-up of a rig from its own records."""

from __future__ import annotations

import argparse

import legid
from experiments import rig, workflows
from experiments.console import note, stages
from legid.cli.answer import answer, chosen_rig
from legid.cli.arguments import DAMAGED, FIX, FORCE, RIG, RUNS, SENSORS
from legid.cli.command import Command, argument, output

COMMAND = Command(
    "tune", "choose a rig's set-up by its records",
    "Choose grid, hold, filter, encoder error and zeros, rotor and offset terms and friction smoothing velocity by "
    "cross-validation. A value is chosen if a fit to half of the runs predicts the other half better with it. Entries "
    "of rig.toml outside [sampling] are kept. Exit status 1 when no fit predicts; nothing is chosen then.", (
        RUNS, RIG, DAMAGED, SENSORS, FIX,
        argument("--write", action="store_true", help="put what was chosen into the rig file, comments kept"),
        output("--json", "legid.tuning/1", help="write what was chosen and tried as JSON"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Choose, and write into the rig file where that was asked for."""
    where = rig.rig_path(args.rig) if args.write else None
    chosen = chosen_rig(args, args.runs)
    with stages("tuning") as show:
        found = legid.tune(args.runs, chosen, args.sensors, args.damaged, show, dict(args.fix))
    answer(args, found, str(found))
    if where is not None and found.chosen:
        workflows.write_choices(found.chosen, where)
        note(f"{where}: {', '.join(f'[{c.table}] {c.key}' for c in found.chosen)} written")
    elif found.chosen:
        print("next: the same command with --write puts these entries into the rig file")
    return 0 if found.predicts else 1
