"""`legid emulate`: a rig for trying things without hardware."""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments import emulation
from legid.cli.arguments import DRIVE, FORCE, HIDEABLE
from legid.cli.command import Command, argument

COMMAND = Command(
    "emulate", "serve an emulated rig that record, doctor and live open like a real one",
    "Emulate a leg with its IMU and motor controller, byte for byte and in real time, until Ctrl-C. Its rig file and "
    "eight torque plans are written into DIR: legid record --rig DIR/rig.toml --plan DIR/plan1.csv --out run.mcap "
    "works as on a real leg.", (
        argument("--out", metavar="DIR", default="emulated-rig", help="where the files go; default: emulated-rig"),
        argument("--effect", metavar="NAME", choices=HIDEABLE, default="none",
                 help="what is hidden in the leg, as for legid demo; default: none"),
        DRIVE, FORCE,
        argument("--until-eof", action="store_true", help=argparse.SUPPRESS)))  # ends with whoever started it


def run(args: argparse.Namespace) -> int:
    """Serve until a signal comes."""
    import signal
    import sys

    signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    if not args.until_eof:
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)  # before any thread: then they wait for sigwait
    folder = Path(args.out)
    emulation.write_plans(folder)
    hidden = emulation.EFFECTS.get(args.effect, emulation.NOTHING)
    with emulation.ServedRig(folder, hidden=hidden, drive=args.drive) as served:
        print(f"{served.rig_path}: an emulated rig, served until Ctrl-C", flush=True)
        if args.until_eof:
            sys.stdin.read()
        else:
            signal.sigwait(signals)
    return 0
