"""`legid diagnose`: what the simulation gets wrong, why, and what extending it gains."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import legid
from experiments import workflows
from experiments.console import stages, warn
from legid.cli.answer import answer, chosen_rig, given_reference, refuse
from legid.cli.arguments import (
    DAMAGED,
    FORCE,
    HTML,
    MOST_WORKERS,
    RIG,
    RUNS,
    assignment,
    number,
    whole_number,
)
from legid.cli.command import Command, argument, output

if TYPE_CHECKING:
    from experiments.rig import ChosenRig

COMMAND = Command(
    "diagnose", "name what the model gets wrong and measure what extending it gains",
    "Fit the nominal model and test its residual for causes. Name the cause if the data determine it. Measure on "
    "held-out runs how much the extended model gains. Give several runs (eight of 20 s are good) in the order in which "
    "they were recorded. Exit status 1 when no diagnosis is possible; the JSON is written all the same.", (
        RUNS, RIG, DAMAGED,
        output("--json", "legid.diagnosis/1", help="write the diagnosis as JSON (schema legid.diagnosis/1)"),
        HTML,
        output("--model-out", "legid.model/1", "MODEL.json",
               help="write the extended model (the nominal one where nothing was named) for validate and simulate"),
        FORCE,
        argument("--seed", metavar="N", type=whole_number(0, 2**32 - 1), default=0,
                 help="seed of the bootstrap replicates and intervals; default: 0"),
        argument("--material", metavar="SHARE", default=0.1,
                 type=number(lambda share: 0.0 < share < 1.0, "a share between 0 and 1, such as 0.1"),
                 help="smallest relative reduction of the free-run rms error that counts as material; default: 0.1"),
        argument("--workers", metavar="N", type=whole_number(1, MOST_WORKERS),
                 help="processes that share the work; default: one a core"),
        argument("--fix", metavar="NAME=VALUE", action="append", default=[], type=assignment,
                 help="give a parameter, as runs without a torque need for their scale; may be repeated"),
        argument("--reference", metavar="MODEL.json",
                 help="an earlier model of this rig: parameters that changed are reported, a payload for one"),
        argument("--against", metavar="REFERENCE", nargs="+", default=[],
                 help="earlier runs of this rig, folders of them, or the model that legid diagnose wrote of them: say "
                      "what changed since")))


def run(args: argparse.Namespace) -> int:
    """Say what is wrong, or what changed. Raises `WorkError` with the verdict fit_failed."""
    from experiments.judge import Files

    if args.against:
        refuse(args, ("--model-out", "--reference", "--fix"), "does not go with --against",
               "leave it out; --json holds the whole answer")
    paths = workflows.runs_in(args.runs) if args.against else args.runs
    chosen = chosen_rig(args, paths)
    found = (_changed if args.against else _diagnosed)(args, paths, chosen)
    files = Files(paths, chosen.file, args.model_out, args.json)
    return answer(args, found, "" if found.failed else found.text(files), files)


def _diagnosed(args: argparse.Namespace, paths: list[str], chosen: ChosenRig) -> legid.Diagnosis:
    runs = legid.load(paths, chosen, args.damaged)
    with stages("diagnosing") as show:
        diagnosis = legid.diagnose(runs, chosen, args.seed, args.reference, show, args.workers, args.material,
                                   dict(args.fix))
    for text in diagnosis.prepared.warnings if diagnosis.failed else ():  # else the answer has them
        warn(text)
    return diagnosis


def _changed(args: argparse.Namespace, paths: list[str], chosen: ChosenRig) -> legid.Change:
    model, earlier = given_reference(args.against)
    later = legid.load(paths, chosen, args.damaged)
    return legid.diagnose(later, chosen, against=model or legid.load(earlier, chosen, args.damaged))
