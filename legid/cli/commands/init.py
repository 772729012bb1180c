"""`legid init`: a rig file to start from."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import daq
from daq import InputError
from experiments import rig as rigs
from experiments import simulators
from legid.cli.command import Command, argument, one_of

COMMAND = Command(
    "init", "write a commented rig file, by asking or by probing",
    "Ask what the rig is made of, or look at what is connected (--probe), and write a rig file whose every line is "
    "explained. Unknown values are marked ASSUMED. An existing file is not changed.", (
        argument("rig", metavar="RIG", nargs="?", default="rig.toml", help="file to write (default rig.toml)"),
        one_of(argument("--probe", action="store_true",
                        help="ask the devices: reads identities on every I2C bus, greets what is on USB serial ports "
                             "and on CAN (node 0); a controller is stopped, never armed"),
               argument("--defaults", action="store_true", help="ask nothing, assume everything"),
               argument("--from", dest="source", metavar="FILE",
                        help="a run as CSV: joints, motors and servos by its columns; or a URDF or MJCF of a serial "
                             "planar chain: links, motors and, as [prior], masses and lengths")),
        argument("--port", action="append", help="with --probe: greet only this serial port (may be repeated)")))


def run(args: argparse.Namespace) -> int:
    """Ask or probe, write."""
    path = Path(args.rig)
    if path.exists():
        raise rigs.already_there(path)
    if args.port and not args.probe:
        raise InputError("--port", "is for --probe", "add --probe, or leave it out")
    facts, more = rigs.RigFacts(), ""
    if args.source and rigs.is_run(Path(args.source)):
        facts = rigs.facts_of_run(Path(args.source))
    elif args.source:
        links = simulators.read_robot(Path(args.source))
        model = {1: "joint1", 2: "leg2"}.get(len(links), "chain")
        driven = tuple(j for j, link in enumerate(links, 1) if link.driven)
        driven = driven or rigs.default_actuated(model, len(links))
        facts = rigs.RigFacts(model=model, links=len(links), actuated=driven, known=frozenset({"model", "links"}))
        more = rigs.prior_table(links, Path(args.source).name)
    elif args.probe:
        facts = rigs.probe(facts, print, args.port)
    elif args.defaults:
        facts = rigs.RigFacts(bus="/dev/i2c-1", port="/dev/ttyACM0")
    else:
        print(f"Enter keeps the value in brackets, and marks it ASSUMED in {path}.")
        facts = rigs.ask_facts(facts)
    text = rigs.write_rig(path, facts, more)
    assumed = text.count(daq.ASSUMED)
    marked = f"; {assumed} values are assumed and marked so" if assumed else ""
    rig = shlex.quote(str(path))
    then = f"legid doctor --rig {rig}" if facts.records else f"legid import FILE..., then legid fit RUN... --rig {rig}"
    if facts.servo:
        then = f"give the gain under [servo], or one parameter with --fix, in legid fit RUN... --rig {rig}"
    elif args.source and not facts.records:
        then = f"legid fit RUN... --rig {rig}"
    print(f"{path}: written{marked}. Next: {then}")
    return 0
