"""`legid init`: a rig file to start from."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "init", help="write a commented rig file, by asking or by probing",
        description="Ask what the rig is made of, or look at what is connected (--probe), and write a rig file whose "
                    "every line is explained. What nobody knows is marked ASSUMED. A file that exists is left alone.")
    parser.add_argument("rig", metavar="RIG", nargs="?", default="rig.toml", help="file to write (default rig.toml)")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--probe", action="store_true",
                     help="ask the devices: reads identities on every I2C bus, greets what is on USB serial ports and "
                          "on CAN (node 0); a controller is stopped, never armed")
    how.add_argument("--defaults", action="store_true", help="ask nothing, assume everything")
    parser.add_argument("--port", action="append", help="with --probe: greet only this serial port (may be repeated)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Ask or probe, write."""
    import shlex
    from pathlib import Path

    from daq import ASSUMED, InputError
    from experiments.rig import RigFacts, already_there, ask_facts, probe, write_rig

    path = Path(args.rig)
    if path.exists():
        raise already_there(path)
    if args.port and not args.probe:
        raise InputError("--port", "is for --probe", "add --probe, or leave it out")
    facts = RigFacts()
    if args.probe:
        facts = probe(facts, print, args.port)
    elif args.defaults:
        facts = RigFacts(bus="/dev/i2c-1", port="/dev/ttyACM0")
    else:
        facts = ask_facts(facts)
    text = write_rig(path, facts)
    print(f"{path}: written; {text.count(ASSUMED)} values are assumed and marked so. "
          f"Next: legid doctor --rig {shlex.quote(str(path))}")
    return 0
