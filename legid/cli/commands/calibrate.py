"""`legid calibrate`: what rig.toml's [calibration] and the lever arm need, from records with the motor off."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any

import legid
from experiments import calibrate
from legid.cli.command import Argument, Command, argument

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
    """Measure, say, store."""
    given = {key: value for key, value in vars(args).items() if key in calibrate.Asked.__dataclass_fields__}
    if args.what == "all":
        return _all(args, given)
    outcome = calibrate.MEASUREMENTS[args.what](calibrate.Asked(path=args.rig, **given), legid.load_rig(args.rig))
    print(outcome.text)
    for warning in outcome.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(calibrate.store(outcome, args.rig, args.dry_run))
    return 0


def _all(args: argparse.Namespace, given: dict[str, Any]) -> int:
    walking = calibrate.walkthrough
    does = {"encoder": walking.STRAIGHT} if args.straight else {}
    does |= {"imu": walking.SIX} if args.six_positions else {}
    measure = {step.name: partial(calibrate.MEASUREMENTS[step.name], calibrate.Asked(
        path=args.rig, **given | {"seconds": args.seconds or SECONDS[step.name]})) for step in walking.STEPS}
    print(walking.walk(args.rig, measure, args.dry_run, does))
    return 0
