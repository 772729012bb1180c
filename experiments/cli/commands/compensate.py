"""`legid compensate`: undo a model's named causes by the drive."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import daq
from daq import InputError
from experiments import models, rig, workflows
from experiments.cli.arguments import DAMAGED, FORCE, RIG
from experiments.cli.command import Command, argument, output
from experiments.console import busy, text_table, warn

if TYPE_CHECKING:
    from daq import Rig
    from experiments.models import Model

HEADER = ["cause", "by", "how"]


COMMAND = Command(
    "compensate", "undo a model's named causes by the drive",
    "Say which causes of a diagnosed model torque of the motor undoes. --plan adds that torque to a plan, which every "
    "drive takes. A torque ripple becomes the cogging table of a moteus. Without --write nothing is written, and the "
    "motor stays off in any case.", (
        argument("model", metavar="MODEL.json", help="a model written by legid diagnose --model-out"),
        RIG, DAMAGED,
        argument("--plan", metavar="PLAN.csv", help="a plan whose motion the model without its causes describes"),
        output("--out", "plan", "NEW.csv", help="with --plan: the plan with the torque added"),
        argument("--write", action="store_true", help="write the table into the drive and read it back"),
        FORCE))


def run(args: argparse.Namespace) -> int:
    """Say, and write what was asked for."""
    if (args.plan is None) != (args.out is None):
        raise InputError("--plan and --out", "go together", "give both, or none")
    model, known = models.load_model(args.model), daq.read_rig_file(rig.rig_path(args.rig)).rig
    shares = workflows.shares_of(model, known.devices.controller.kind if known.devices.controller else "none")
    if not shares:
        raise InputError(args.model, "has no named cause", "give a model that legid diagnose --model-out extended")
    print(text_table(HEADER, [list(share) for share in shares], set()))
    if args.plan:
        _add_to_plan(args, model, known)
    if args.write:
        _write_table(args, model, known)
    elif any(share.where == "drive" for share in shares):
        print("Dry run: the drive was not asked, nothing is written. --write opens it, with the motor off, writes the "
              "table, reads it back and keeps it.")
    return 0


def _add_to_plan(args: argparse.Namespace, model: Model, known: Rig) -> None:
    """Write the new plan, and what it gains by simulation."""
    from daq.recording import read_plan, write_plan

    found = workflows.feedforward(model, read_plan(args.plan), args.model)
    write_plan(found.plan, args.out)
    print(f"{args.out}: {args.plan} with the torque that the causes need. Distance of the driven joint from the model "
          f"without them, by simulation: {found.before:.4g} rad rms before, {found.after:.4g} after.")
    for what, value, most in (("torque", found.plan.peak_nm, known.limits.torque_nm),
                              ("slew rate", found.plan.slew_nmps, known.limits.slew_nmps)):
        if value > most:
            warn(f"{args.out}: its {what} of {value:.4g} is beyond the rig's limit of {most:g}, so legid record "
                 "refuses it")


def _write_table(args: argparse.Namespace, model: Model, known: Rig) -> None:
    """Write the table into the drive."""
    if known.devices.controller is None:
        raise InputError("the rig file", "has no [devices.controller]", "name the port that the drive is on")
    with rig.connect(known.devices.controller, known) as drive, busy("writing the table into the drive"):
        drive.open()
        setting, configure = (getattr(drive, name, None) for name in ("setting", "configure"))
        settings = workflows.cogging_settings(model, known, setting or (lambda name: 0.0), args.model)
        if configure is not None:
            configure(settings)
    peak = 127 * settings["motor.cogging_dq_scale"] * known.calibration.torque_constant_nm_per_a
    print(f"{len(settings) - 1} entries of motor.cogging_dq_comp are written, read back and kept: at most {peak:.3g} "
          f"N m at the joint. The measured current holds them from now on. Raise limits.torque_band_nm by {peak:.2g}, "
          "record the same plan as before, and compare the motions.")
