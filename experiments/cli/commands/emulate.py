"""`legid emulate`: a rig for trying things without hardware."""

from __future__ import annotations

import argparse

from experiments.cli.arguments import add_force
from experiments.cli.commands.demo import HIDEABLE


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "emulate", help="serve an emulated rig that record, doctor and live open like a real one",
        description="Emulate a leg with its IMU and motor controller, byte for byte and in real time, until Ctrl-C. "
                    "Its rig file and eight torque plans are written into DIR: legid record --rig DIR/rig.toml "
                    "--plan DIR/plan1.csv --out run.mcap works as on a real leg.")
    parser.add_argument("--out", metavar="DIR", default="emulated-rig", help="where the files go; "
                                                                             "default: emulated-rig")
    parser.add_argument("--effect", metavar="NAME", choices=HIDEABLE, default="none",
                        help="what is hidden in the leg, as for legid demo; default: none")
    parser.add_argument("--drive", metavar="KIND", default="legid",
                        help="what turns the knee: legid (our own firmware, the default), moteus or another drive that "
                             "has an emulator")
    add_force(parser)
    parser.add_argument("--until-eof", action="store_true", help=argparse.SUPPRESS)  # ends with whoever started it
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal comes."""
    import signal
    import sys
    from pathlib import Path

    from experiments.emulation import EFFECTS, NOTHING, ServedRig, write_plans

    signals = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    if not args.until_eof:
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)  # before any thread: then they wait for sigwait
    folder = Path(args.out)
    write_plans(folder)
    with ServedRig(folder, hidden=EFFECTS.get(args.effect, NOTHING), drive=args.drive) as served:
        print(f"{served.rig_path}: an emulated rig, served until Ctrl-C", flush=True)
        if args.until_eof:
            sys.stdin.read()
        else:
            signal.sigwait(signals)
    return 0
