"""`legid live`: the dashboard."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "live", help="a web page to watch, start and stop recordings, with an emergency stop",
        description="Serve a page that shows devices, signals and limits while a recording runs, starts and stops it, "
                    "and fits and diagnoses its runs. The page's process opens no device: each recording is a process "
                    "of its own, which stops the motor when the page's process dies or falls silent. It needs the "
                    "extra: pip install legid[live].")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--rig", help="the rig's TOML file, with [devices] and [limits]")
    which.add_argument("--demo", action="store_true", help="no hardware: an emulated rig, with an effect hidden in it")
    parser.add_argument("--plans", metavar="DIR", help="folder with torque plans (CSV); default: the rig file's")
    parser.add_argument("--out", metavar="DIR", default="live-out", help="where runs and reports go; default: live-out")
    parser.add_argument("--host", default="127.0.0.1",
                        help="address to listen on; any but this machine's own makes a token, printed with the "
                             "address; default: 127.0.0.1")
    parser.add_argument("--token", action="store_true",
                        help="ask for a token on this machine, too, where others have accounts")
    parser.add_argument("--estop-at-hand", action="store_true",
                        help="on a drive other than our own firmware: a hard-wired emergency stop is within reach, so "
                             "do not ask")
    parser.add_argument("--port", type=_port, default=8080, help="default: 8080; 0 takes any that is free")
    parser.set_defaults(run=run)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    from contextlib import ExitStack
    from importlib.util import find_spec
    from pathlib import Path

    from daq import WorkError, read_rig_file
    from experiments.console import make_directory

    if find_spec("nicegui") is None:
        raise WorkError("needs the extra: pip install legid[live]")
    from experiments.live import serve, started_demo_rig
    from experiments.rig import confirm_estop

    out = Path(args.out).absolute()
    make_directory(out)
    with ExitStack() as stack:
        path = stack.enter_context(started_demo_rig(out / "rig")) if args.demo else Path(args.rig).absolute()
        rig = read_rig_file(path)
        if not args.demo:
            confirm_estop(rig.rig, args.estop_at_hand)
        serve(rig, Path(args.plans).absolute() if args.plans else path.parent, out, args.host, args.port,
              args.token)
    return 0
