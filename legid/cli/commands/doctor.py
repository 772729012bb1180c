"""`legid doctor`: is the rig ready to record?"""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import daq
from daq import InputError, WorkError
from experiments import doctor, workflows
from legid.cli.answer import chosen_rig
from legid.cli.arguments import number
from legid.cli.command import Command, argument

COMMAND = Command(
    "doctor", "check devices, clocks, zeros and disk before recording",
    "One line for each check, with what to do where it fails; exit status 1 when one does. The motor is stopped and "
    "stays off. Let the leg hang still, or swing it by hand with --move.", (
        argument("runs", metavar="RUN", nargs="*", help="with --model: runs to hold it against"),
        argument("--model", metavar="FILE",
                 help="a URDF or MJCF file: how far its free runs err on the runs, and which of its parameters they "
                      "contradict; no device is looked at"),
        argument("--rig", help="the rig's TOML file; default: devices at their usual places"),
        argument("--move", metavar="SECONDS", nargs="?", const=10.0,
                 type=number(lambda s: 1.0 <= s <= 600.0, "1 to 600 s"),
                 help="swing the leg by hand for so long (default 10): do encoders and IMU agree?"),
        argument("--clear-faults", action="store_true",
                 help="have the controller forget the faults it has latched, once their cause is removed"),
        argument("--out", metavar="DIR", default=".", help="where runs will be recorded (default: here)"),
        argument("--rig-sha256", metavar="HEX", default="", help=argparse.SUPPRESS)))  # legid live: as it was read


def run(args: argparse.Namespace) -> int:
    """Check, say, judge."""
    if args.model or args.runs:
        return _judge_model(args)
    file = daq.read_rig_file(args.rig, args.rig_sha256) if args.rig else None
    rig, text = (file.rig, file.text) if file else (doctor.default_rig(), "")
    checks = doctor.examine(rig, text, args.rig or "the usual places", Path(args.out), args.move, args.clear_faults)
    print(doctor.checks_text(checks))
    failed = [check.name for check in checks if check.status == "FAIL"]
    if failed:
        raise WorkError(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}")
    warned = ", with warnings" if any(c.status == "warn" for c in checks) else ""
    then = f". Next: legid excite --rig {shlex.quote(args.rig)} --out PLAN.csv" if args.rig else ""
    print(f"all {len(checks)} checks passed{warned}{then}")
    return 0


def _judge_model(args: argparse.Namespace) -> int:
    """Hold a robot file against runs."""
    if not args.model or not args.runs:
        raise InputError("--model", "needs a robot file and runs", "legid doctor --model leg.xml RUN... --rig RIG")
    print(workflows.judge_robot(Path(args.model), args.runs, chosen_rig(args, args.runs).rig).text())
    return 0
