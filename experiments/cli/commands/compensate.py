"""`legid compensate`: undo a model's named causes by the drive."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from experiments.cli.arguments import add_force, add_output, add_rig

if TYPE_CHECKING:
    from daq import Rig
    from experiments.models import Model

HEADER = ["cause", "by", "how"]


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "compensate", help="undo a model's named causes by the drive",
        description="Say which causes of a diagnosed model torque of the motor undoes. --plan adds that torque to a "
                    "plan, which every drive takes. A torque ripple becomes the cogging table of a moteus. Without "
                    "--write nothing is written, and the motor stays off in any case.")
    parser.add_argument("model", metavar="MODEL.json", help="a model written by legid diagnose --model-out")
    add_rig(parser)
    parser.add_argument("--plan", metavar="PLAN.csv", help="a plan whose motion the model without its causes describes")
    add_output(parser, "--out", "plan", "NEW.csv", help="with --plan: the plan with the torque added")
    parser.add_argument("--write", action="store_true", help="write the table into the drive and read it back")
    add_force(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Say, and write what was asked for."""
    from daq import InputError, read_rig_file
    from experiments.console import text_table
    from experiments.models import load_model
    from experiments.rig import rig_path
    from experiments.workflows import shares_of

    if (args.plan is None) != (args.out is None):
        raise InputError("--plan and --out", "go together", "give both, or none")
    model, rig = load_model(args.model), read_rig_file(rig_path(args.rig)).rig
    shares = shares_of(model, rig.devices.controller.kind if rig.devices.controller else "none")
    if not shares:
        raise InputError(args.model, "has no named cause", "give a model that legid diagnose --model-out extended")
    print(text_table(HEADER, [list(share) for share in shares], set()))
    if args.plan:
        _add_to_plan(args, model, rig)
    if args.write:
        _write_table(args, model, rig)
    elif any(share.where == "drive" for share in shares):
        print("Dry run: the drive was not asked, nothing is written. --write opens it, with the motor off, writes the "
              "table, reads it back and keeps it.")
    return 0


def _add_to_plan(args: argparse.Namespace, model: Model, rig: Rig) -> None:
    """Write the new plan, and what it gains by simulation."""
    from daq.recording import read_plan, write_plan
    from experiments.console import warn
    from experiments.workflows import feedforward

    found = feedforward(model, read_plan(args.plan), args.model)
    write_plan(found.plan, args.out)
    print(f"{args.out}: {args.plan} with the torque that the causes need. Distance of the driven joint from the model "
          f"without them, by simulation: {found.before:.4g} rad rms before, {found.after:.4g} after.")
    for what, value, most in (("torque", found.plan.peak_nm, rig.limits.torque_nm),
                              ("slew rate", found.plan.slew_nmps, rig.limits.slew_nmps)):
        if value > most:
            warn(f"{args.out}: its {what} of {value:.4g} is beyond the rig's limit of {most:g}, so legid record "
                 "refuses it")


def _write_table(args: argparse.Namespace, model: Model, rig: Rig) -> None:
    """Write the table into the drive."""
    from daq import InputError
    from experiments.console import busy
    from experiments.rig import connect
    from experiments.workflows import cogging_settings

    if rig.devices.controller is None:
        raise InputError("the rig file", "has no [devices.controller]", "name the port that the drive is on")
    with connect(rig.devices.controller, rig) as drive, busy("writing the table into the drive"):
        drive.open()
        setting, configure = (getattr(drive, name, None) for name in ("setting", "configure"))
        settings = cogging_settings(model, rig, setting or (lambda name: 0.0), args.model)
        if configure is not None:
            configure(settings)
    peak = 127 * settings["motor.cogging_dq_scale"] * rig.calibration.torque_constant_nm_per_a
    print(f"{len(settings) - 1} entries of motor.cogging_dq_comp are written, read back and kept: at most {peak:.3g} "
          f"N m at the joint. The measured current holds them from now on. Raise limits.torque_band_nm by {peak:.2g}, "
          "record the same plan as before, and compare the motions.")
