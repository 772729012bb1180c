"""`legid record`: a real experiment."""

from __future__ import annotations

import argparse


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "record", help="run a torque plan on the real leg and record it",
        description="Open the devices of the rig file, run the plan under the rig's limits and record everything. "
                    "Ctrl-C stops the motor at once; what was recorded until then is kept.")
    parser.add_argument("--rig", required=True, help="the rig's TOML file, with [devices] and [limits]")
    parser.add_argument("--plan", required=True, help="torque plan: CSV with time_s,tau2_cmd_nm")
    parser.add_argument("--out", metavar="RUN.mcap", required=True, help="the run file to write; never overwritten")
    parser.add_argument("--watched-by", metavar="FD", type=int, help=argparse.SUPPRESS)  # legid live: see daq.remote
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record one run on real devices."""
    import sys
    from pathlib import Path

    from daq.errors import InputError
    from daq.plan import read_plan
    from daq.recorder import record_run
    from daq.remote import watched_by
    from daq.rig import load_rig
    from experiments.devices import open_devices
    from experiments.output import progress_to
    from experiments.run_info import clock_warnings

    with watched_by(args.watched_by) as remote:
        rig, plan = load_rig(args.rig), read_plan(args.plan)
        if not args.out.lower().endswith(".mcap"):
            raise InputError("--out", f"{args.out} does not end in .mcap", "name a native run file")
        rig_text = Path(args.rig).read_text(encoding="utf-8")
        with open_devices(rig, args.rig) as (imu, controller), progress_to("recording") as report:
            done = record_run(args.out, rig, rig_text, plan, imu, controller, progress=report, remote=remote)
            warnings = clock_warnings(done.clock_bound_s, controller.link_facts)
    print(f"{args.out}: {done.duration_s:.1f} s, {done.messages} messages, {done.imu_samples} IMU samples, "
          f"{done.commands} torque commands ({done.late_commands} left out as late), "
          f"controller clock known to {done.clock_bound_s * 1e6:.0f} us")
    for line in warnings:
        print(line, file=sys.stderr)
    return 0
