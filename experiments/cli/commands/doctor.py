"""`legid doctor`: is the rig ready to record?"""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "doctor", help="check devices, clocks, zeros and disk before recording",
        description="One line for each check, with what to do where it fails; exit status 1 when one does. The motor "
                    "is stopped and stays off. Let the leg hang still, or swing it by hand with --move.")
    parser.add_argument("runs", metavar="RUN", nargs="*", help="with --model: runs to hold it against")
    parser.add_argument("--model", metavar="FILE",
                        help="a URDF or MJCF file: how far its free runs err on the runs, and which of its parameters "
                             "they contradict; no device is looked at")
    parser.add_argument("--rig", help="the rig's TOML file; default: devices at their usual places")
    parser.add_argument("--move", metavar="SECONDS", nargs="?", type=_seconds, const=10.0,
                        help="swing the leg by hand for so long (default 10): do encoders and IMU agree?")
    parser.add_argument("--clear-faults", action="store_true",
                        help="have the controller forget the faults it has latched, once their cause is removed")
    parser.add_argument("--out", metavar="DIR", default=".", help="where runs will be recorded (default: here)")
    parser.add_argument("--rig-sha256", metavar="HEX", default="", help=argparse.SUPPRESS)  # legid live: as it was read
    parser.set_defaults(run=run)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1.0 <= value <= 600.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not 1 to 600 s")
    return value


def run(args: argparse.Namespace) -> int:
    """Check, say, judge."""
    import shlex
    from pathlib import Path

    from daq import WorkError, read_rig_file
    from experiments.doctor import checks_text, default_rig, examine

    if args.model or args.runs:
        return _judge_model(args)
    file = read_rig_file(args.rig, args.rig_sha256) if args.rig else None
    rig, text = (file.rig, file.text) if file else (default_rig(), "")
    checks = examine(rig, text, args.rig or "the usual places", Path(args.out), args.move, args.clear_faults)
    print(checks_text(checks))
    failed = [check.name for check in checks if check.status == "FAIL"]
    if failed:
        raise WorkError(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}")
    warned = ", with warnings" if any(c.status == "warn" for c in checks) else ""
    then = f". Next: legid excite --rig {shlex.quote(args.rig)} --out PLAN.csv" if args.rig else ""
    print(f"all {len(checks)} checks passed{warned}{then}")
    return 0


def _judge_model(args: argparse.Namespace) -> int:
    """Hold a robot file against runs."""
    from pathlib import Path

    from daq import InputError
    from experiments.cli.arguments import chosen_rig
    from experiments.workflows import judge_robot

    if not args.model or not args.runs:
        raise InputError("--model", "needs a robot file and runs", "legid doctor --model leg.xml RUN... --rig RIG")
    print(judge_robot(Path(args.model), args.runs, chosen_rig(args, args.runs).rig).text())
    return 0
