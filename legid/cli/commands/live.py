"""`legid live`: the dashboard."""

from __future__ import annotations

import argparse
from pathlib import Path

import daq
from daq import WorkError
from experiments.console import make_directory
from legid.cli.arguments import ESTOP, whole_number
from legid.cli.command import Command, argument, one_of

COMMAND = Command(
    "live", "a web page to watch, start and stop recordings, with an emergency stop",
    "Serve a page that shows devices, signals and limits while a recording runs, starts and stops it, and fits and "
    "diagnoses its runs. The page's process opens no device: each recording is a process of its own, which stops the "
    "motor when the page's process dies or falls silent. It needs the extra: pip install legid[live].", (
        one_of(argument("--rig", help="the rig's TOML file, with [devices] and [limits]"),
               argument("--demo", action="store_true",
                        help="no hardware: an emulated rig, with an effect hidden in it"), required=True),
        argument("--plans", metavar="DIR", help="folder with torque plans (CSV); default: the rig file's"),
        argument("--out", metavar="DIR", default="live-out", help="where runs and reports go; default: live-out"),
        argument("--host", default="127.0.0.1",
                 help="address to listen on; any but this machine's own makes a token, printed with the address; "
                      "default: 127.0.0.1"),
        argument("--token", action="store_true",
                 help="ask for a token on this machine, too, where others have accounts"),
        ESTOP,
        argument("--port", type=whole_number(0, 65535, "a port"), default=8080,
                 help="default: 8080; 0 takes any that is free")))


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    from contextlib import ExitStack
    from importlib.util import find_spec

    if find_spec("nicegui") is None:
        raise WorkError("needs the extra: pip install legid[live]")
    from experiments.live import serve, started_demo_rig
    from experiments.rig import confirm_estop

    out = Path(args.out).absolute()
    make_directory(out)
    with ExitStack() as stack:
        path = stack.enter_context(started_demo_rig(out / "rig")) if args.demo else Path(args.rig).absolute()
        rig = daq.read_rig_file(path)
        if not args.demo:
            confirm_estop(rig.rig, args.estop_at_hand)
        serve(rig, Path(args.plans).absolute() if args.plans else path.parent, out, args.host, args.port,
              args.token)
    return 0
