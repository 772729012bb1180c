"""`legid calibrate`: what rig.toml's [calibration] and the lever arm need, from records with the motor off."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import legid
from daq import InputError, WorkError
from experiments import calibrate
from experiments.cli.command import Argument, Command, argument

if TYPE_CHECKING:
    from daq import Rig
    from daq.calibration import StillRecord
    from daq.runs import RawRun
    from experiments.calibrate import Outcome, Wanted
    from experiments.models import Model

SECONDS = {"imu": 60.0, "mount": 20.0, "encoder": 10.0, "pivot": 10.0, "shunt": 20.0, "imu-encoder": 60.0}
"""Length of a record from the devices."""


def _step(name: str, about: str, more: str, runs: str, *extra: Argument) -> Command:
    return Command(name, about, f"{about[0].upper()}{about[1:]}. {more}", (
        argument("runs", metavar="RUN", nargs="*", help=runs),
        argument("--rig", default="rig.toml",
                 help="the rig's TOML file, into which the results are written; default: ./rig.toml"),
        argument("--seconds", type=float, default=SECONDS[name],
                 help=f"length of each record from the devices (default {SECONDS[name]:g})"),
        DRY_RUN, *extra))


DRY_RUN = argument("--dry-run", action="store_true", help="print only, leave the rig file as it is")
MODEL = argument("--model", metavar="MODEL.json", help="an identified leg: how far its friction holds it")
HALF = "half of its 95 %% interval"
COMMAND = Command(
    "calibrate", "calibrate IMU, knee encoder, mount and shunt from records with the motor off",
    "Measure what the rig file must know and write it there; comments stay. Without RUN the devices of the rig file "
    "are read, the motor stays off. Every figure comes with its 95 % interval.",
    title="what to calibrate", steps=(
        _step("imu", "biases, noise and scales of the IMU, from records at rest",
              "Gyro bias and noise (Allan deviation) from a record of an IMU that lies still; with six, each with "
              "another axis of the chip up or down, accelerometer bias and scales too.",
              "one or six .mcap files recorded at rest",
              argument("--six-positions", action="store_true", help="ask for six positions of the chip, one by one"),
              argument("--self-test", action="store_true", help="first let the chip test itself; keep it still")),
        _step("mount", "how the IMU sits on link 1, and its lever arm, from rest and swing",
              "Mount matrix and lever arm by maximum likelihood of the swing and the chip's six readings; where q1 = 0 "
              "is, comes from the leg hanging at rest.", ".mcap files: the leg at rest, and swinging", MODEL),
        _step("encoder", "the knee encoder's reading at a straight knee",
              "From a leg hanging free, whose knee stops anywhere in its friction's cone about the vertical, or held "
              "straight (--straight).", ".mcap files at rest, each another stop of the leg",
              argument("--straight", action="store_true", help="the leg is held or clamped straight"),
              argument("--records", metavar="N", type=int, help="so many stops from the devices"), MODEL),
        _step("pivot", "what the pivot sensor reads when link 1 hangs straight down",
              "Its mean reading at rest, less link 1's angle by gravity where the IMU is recorded too.",
              ".mcap files at rest",
              argument("--records", metavar="N", type=int, default=4,
                       help="so many stops from the devices (default 4)")),
        _step("shunt", "offset of the current shunt, or by a known weight the torque constant",
              "Mean current while the motor is off, with its drift. With --weight the torque constant: from runs of a "
              "staircase plan (legid excite --holds), RUN without the weight and --weighted with it.",
              ".mcap files with the motor off; with --weight runs of holds, of any kind",
              argument("--weight", metavar="KG", type=float, help="mass that was fixed to link 2"),
              argument("--arm", metavar="M", type=float, help="from the knee's axis to its centre of mass"),
              argument("--weight-error", metavar="KG", type=float, default=0.0, help=HALF),
              argument("--arm-error", metavar="M", type=float, default=0.0, help=HALF),
              argument("--weighted", metavar="RUN", nargs="+", default=[], help="runs of holds with the weight on")),
        _step("imu-encoder", "the IMU on a moving link against the encoder of that link's angle",
              "Gyro bias, scale and lag, accelerometer biases, scales and lag, and the lever arm, by least squares on "
              "q1_rad: fitted on the first half, checked on the other. No torque is needed.",
              ".mcap or .csv files with q1_rad and IMU of a moving link"),
        Command("all", "walk through imu, mount, encoder and shunt on a terminal",
                "One step after another, each with what to do with the leg before it; a step can be skipped or taken "
                "again. Readings come from the devices of the rig file, the motor stays off.", (
                    argument("--rig", default="rig.toml",
                             help="the rig's TOML file, into which each step writes what it finds; default: "
                                  "./rig.toml"),
                    argument("--seconds", type=float, help="length of each record (default: each step's own)"),
                    argument("--straight", action="store_true", help="the knee's zero from a leg held straight"),
                    argument("--six-positions", action="store_true",
                             help="the accelerometer's biases and scales too, from six positions of the chip"),
                    MODEL, DRY_RUN))))


def run(args: argparse.Namespace) -> int:
    """Measure, say, calibrate.store."""
    if args.what == "all":
        return _all(args)
    rig = legid.load_rig(args.rig)
    outcome = STEPS[args.what](args, rig)
    print(outcome.text)
    for warning in outcome.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(calibrate.store(outcome, args.rig, args.dry_run))
    return 0


def _imu(args: argparse.Namespace, rig: Rig) -> Outcome:
    from experiments.calibrate import imu as calibrating

    records = _recorded(args.runs) if args.runs else _measured(args, rig)
    gyro, accel = calibrating.calibrate(records, rig.mechanism.gravity_mps2)
    left = {} if accel is None else {"accelerometer_bias": accel.residual_mps2}
    return calibrate.Outcome(calibrating.calibration_text(gyro, accel),
                             {"calibration": calibrating.calibration_values(gyro, accel)}, tolerances=left)


def _encoder(args: argparse.Namespace, rig: Rig) -> Outcome:
    from experiments.calibrate import encoder_and_shunt as leg

    model = _model(args)
    if args.records is not None and args.records < 1:
        raise InputError("--records", f"is {args.records}", "give 1 or more")
    count = args.records or (1 if args.straight else leg.fewest_stops(model))
    wishes = leg.straight_wishes(count) if args.straight else leg.hanging_wishes(count)
    return leg.calibrate_knee(_records(args, rig, wishes), rig, args.straight, model)


def _pivot(args: argparse.Namespace, rig: Rig) -> Outcome:
    if args.records < 1:
        raise InputError("--records", f"is {args.records}", "give 1 or more")
    return calibrate.calibrate_pivot(_records(args, rig, calibrate.pivot_wishes(args.records), controller=False), rig)


def _mount(args: argparse.Namespace, rig: Rig) -> Outcome:
    model = _model(args)
    return calibrate.calibrate_mount(_records(args, rig, calibrate.MOUNT_WISHES, controller=False), rig, model)


def _shunt(args: argparse.Namespace, rig: Rig) -> Outcome:
    if args.weight is not None or args.arm is not None or args.weighted:
        return _torque_constant(args, rig)
    return calibrate.calibrate_shunt(_records(args, rig, calibrate.shunt_wishes()), rig)


def _torque_constant(args: argparse.Namespace, rig: Rig) -> Outcome:
    from estimator.calibration import Weight
    from experiments.session import load_runs

    for flag, value in (("--weight", args.weight), ("--arm", args.arm)):
        if value is None or not 1e-4 <= value <= 100.0:
            raise InputError(flag, f"is {value}", "give the weight's mass in kg and its arm in m")
    for flag, value in (("--weight-error", args.weight_error), ("--arm-error", args.arm_error)):
        if not 0.0 <= value <= 1.0:
            raise InputError(flag, f"is {value}", "give half of the 95 % interval, 0 or more")
    if not args.runs or not args.weighted:
        raise InputError("RUN", "holds with the weight and without it are needed", "record both with a plan of legid "
                         "excite --holds and give RUN... --weighted RUN...")
    weight = Weight(args.weight, args.arm, args.weight_error, args.arm_error)
    return calibrate.calibrate_torque_constant(load_runs(args.runs, rig), load_runs(args.weighted, rig), rig, weight)


def _imu_encoder(args: argparse.Namespace, rig: Rig) -> Outcome:
    if not args.runs and rig.devices.pivot is None:  # before a minute of swinging
        raise InputError("imu-encoder", "needs the angle of the IMU's link, and the rig has no [devices.pivot]",
                         "add that sensor, or give runs with q1_rad; legid calibrate imu needs none")
    records = None if args.runs else _records(args, rig, calibrate.SWING_WISHES)
    return calibrate.calibrate_by_encoder(records, args.runs, rig)


STEPS = {"imu": _imu, "mount": _mount, "encoder": _encoder, "pivot": _pivot, "shunt": _shunt,
         "imu-encoder": _imu_encoder}


def _all(args: argparse.Namespace) -> int:
    from functools import partial

    from experiments.calibrate import walkthrough as walking

    does = {"encoder": walking.STRAIGHT} if args.straight else {}
    does |= {"imu": walking.SIX} if args.six_positions else {}
    measure = {}
    for step in walking.STEPS:
        own = vars(args) | {"runs": [], "records": None, "self_test": False,
                            "weight": None, "arm": None, "weighted": []}
        own["seconds"] = args.seconds or SECONDS[step.name]
        measure[step.name] = partial(STEPS[step.name], argparse.Namespace(**own))
    print(walking.walk(args.rig, measure, args.dry_run, does))
    return 0


def _records(args: argparse.Namespace, rig: Rig, wishes: Sequence[Wanted], controller: bool = True) -> list[RawRun]:
    """From the files given, else from the devices."""
    if args.runs:
        return calibrate.read_records(args.runs)
    text = Path(args.rig).read_text(encoding="utf-8")
    return calibrate.record_off(rig, text, args.rig, wishes, args.seconds, controller)


def _model(args: argparse.Namespace) -> Model | None:
    """The identified leg, where one is given."""
    from experiments.models import load_model

    if args.model is None:
        return None
    model = load_model(args.model)
    if model.mechanism.model != "leg2":
        raise InputError(args.model, f"is a model of {model.mechanism.model}", "give that of a leg2")
    return model


def _recorded(paths: Sequence[str]) -> list[StillRecord]:
    """Still records from run files."""
    from daq.calibration import still_record
    from daq.runs import read_run

    if len(paths) not in (1, calibrate.POSITIONS):
        raise InputError("RUN", f"{len(paths)} files given", "give one still record, or six for six positions")
    return [still_record(read_run(path)) for path in paths]


def _measured(args: argparse.Namespace, rig: Rig) -> list[StillRecord]:
    """Still records from the chip."""
    from experiments.rig import open_imu

    if rig.devices.imu is None:
        raise InputError(args.rig, "has no [devices.imu]", "describe the IMU, or give records as RUN")
    records = []
    with open_imu(rig.devices.imu, args.rig) as imu:
        if args.self_test:
            words, passed = calibrate.self_test_text(imu.bus, rig.devices.imu)
            print(words)
            if not passed:
                raise WorkError("the IMU's self-test failed; the chip is damaged, or it moved meanwhile")
            imu.open()
        for position in range(calibrate.POSITIONS if args.six_positions else 1):
            if args.six_positions:
                calibrate.answer(f"position {position + 1} of {calibrate.POSITIONS}: lay the chip on another face, "
                                 "then press Enter ")
            print(f"keep still for {args.seconds:g} s", flush=True)
            records.append(calibrate.record_still(imu, args.seconds, f"record {position + 1}"))
    return records
