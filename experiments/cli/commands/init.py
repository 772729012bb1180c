"""`legid init`: a rig file to start from."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "init", help="write a commented rig file, by asking or by probing",
        description="Ask what the rig is made of, or look at what is connected (--probe), and write a rig file whose "
                    "every line is explained. Unknown values are marked ASSUMED. An existing file is not changed.")
    parser.add_argument("rig", metavar="RIG", nargs="?", default="rig.toml", help="file to write (default rig.toml)")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--probe", action="store_true",
                     help="ask the devices: reads identities on every I2C bus, greets what is on USB serial ports and "
                          "on CAN (node 0); a controller is stopped, never armed")
    how.add_argument("--defaults", action="store_true", help="ask nothing, assume everything")
    how.add_argument("--from", dest="source", metavar="FILE",
                     help="a run as CSV: joints, motors and servos by its columns; or a URDF or MJCF of a serial "
                          "planar chain: links, motors and, as [prior], masses and lengths")
    parser.add_argument("--port", action="append", help="with --probe: greet only this serial port (may be repeated)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Ask or probe, write."""
    import shlex
    from pathlib import Path

    from daq import ASSUMED, InputError
    from experiments.rig import (
        RigFacts,
        already_there,
        ask_facts,
        default_actuated,
        facts_of_run,
        is_run,
        prior_table,
        probe,
        write_rig,
    )
    from experiments.simulators import read_robot

    path = Path(args.rig)
    if path.exists():
        raise already_there(path)
    if args.port and not args.probe:
        raise InputError("--port", "is for --probe", "add --probe, or leave it out")
    facts, more = RigFacts(), ""
    if args.source and is_run(Path(args.source)):
        facts = facts_of_run(Path(args.source))
    elif args.source:
        links = read_robot(Path(args.source))
        model = {1: "joint1", 2: "leg2"}.get(len(links), "chain")
        driven = tuple(j for j, link in enumerate(links, 1) if link.driven)
        facts = RigFacts(model=model, links=len(links), actuated=driven or default_actuated(model, len(links)),
                         known=frozenset({"model", "links"}))
        more = prior_table(links, Path(args.source).name)
    elif args.probe:
        facts = probe(facts, print, args.port)
    elif args.defaults:
        facts = RigFacts(bus="/dev/i2c-1", port="/dev/ttyACM0")
    else:
        print(f"Enter keeps the value in brackets, and marks it ASSUMED in {path}.")
        facts = ask_facts(facts)
    text = write_rig(path, facts, more)
    assumed = text.count(ASSUMED)
    marked = f"; {assumed} values are assumed and marked so" if assumed else ""
    rig = shlex.quote(str(path))
    then = f"legid doctor --rig {rig}" if facts.records else f"legid import FILE..., then legid fit RUN... --rig {rig}"
    if facts.servo:
        then = f"give the gain under [servo], or one parameter with --fix, in legid fit RUN... --rig {rig}"
    elif args.source and not facts.records:
        then = f"legid fit RUN... --rig {rig}"
    print(f"{path}: written{marked}. Next: {then}")
    return 0
