"""`legid record`: a real experiment, or the same on an emulated leg."""

from __future__ import annotations

import argparse
import sys

import daq
from daq import InputError
from experiments import reports, rig, workflows
from experiments.console import busy, progress_to, warn
from legid.cli.arguments import ESTOP, HIDEABLE, RIG_ALONE, SEED
from legid.cli.command import Command, argument, one_of, output

COMMAND = Command(
    "record", "run a torque plan on the real leg and record it",
    "Open the devices of the rig file, run the plan under the rig's limits and record everything. Ctrl-C stops the "
    "motor at once; what was recorded until then is kept. With --emulate no device is opened: the rig's IMU, "
    "controller and a leg are emulated, for practice. With --replay neither: a recorded run is played back through "
    "drivers and intakes, no motor moves.", (
        RIG_ALONE,
        one_of(argument("--plan", help="torque plan: CSV with time_s,tau2_cmd_nm"),
               argument("--replay", metavar="RUN.mcap",
                        help="play this run back instead: the bytes that were read then, to the same drivers, under "
                             "the rig that it holds or that of --rig"), required=True),
        output("--out", "run", "RUN.mcap", required=True, help="the run file to write; never overwritten"),
        ESTOP,
        argument("--watched-by", metavar="FD", type=int, help=argparse.SUPPRESS),  # legid live: see daq.remote
        argument("--rig-sha256", metavar="HEX", default="", help=argparse.SUPPRESS),  # legid live: as it was read
        argument("--emulate", metavar="NAME", nargs="?", const="none", choices=HIDEABLE,
                 help="record an emulated leg of the rig's kind instead, with this hidden in it: "
                      f"{', '.join(HIDEABLE)} (the default)"),
        argument("--seed", metavar="N", type=SEED, default=1, help="of the emulated leg's noise; default: 1")))


def run(args: argparse.Namespace) -> int:
    """Record one run."""
    if args.replay:
        return _replay(args)
    from daq.recording import read_plan, watched_by
    from daq.runs import read_run

    with watched_by(args.watched_by) as remote, progress_to("recording") as report:
        file, plan = daq.read_rig_file(rig.rig_path(args.rig), args.rig_sha256), read_plan(args.plan)
        if args.emulate is None:
            rig.confirm_estop(file.rig, args.estop_at_hand)
            print("The leg will move: hardwired emergency stop at hand, nobody within its reach (docs/safety.md).",
                  flush=True)
        done, warnings = workflows.record_plan(file, plan, args.out, args.emulate, args.seed, report, remote)
    print(f"{args.out}: {done.duration_s:.1f} s, {done.messages} messages, {done.imu_samples} IMU samples, "
          f"{done.commands} torque commands ({done.late_commands} left out as late), "
          f"controller clock known to {done.clock_bound_s * 1e6:.0f} us")
    for line in (*warnings, *(f"warning: {text}" for text in reports.recorded_readings(read_run(args.out)))):
        print(line, file=sys.stderr)
    return 0


def _replay(args: argparse.Namespace) -> int:
    """Play a run back; devices stay closed."""
    if args.emulate or args.watched_by is not None:
        raise InputError("--replay", "plays a recording", "leave out --emulate")
    with busy(f"replaying {args.replay}"):
        done = workflows.replay_recording(args.replay, args.out, args.rig)
    print(f"{args.out}: REPLAY of {args.replay}, nothing was measured and no motor moved: {done.messages} messages, "
          f"{done.imu_samples} IMU samples")
    if done.left_out:
        warn(f"{done.left_out} slow readings of the IMU were left out: they are not played back")
    if done.trip:
        print(f"by the limits of {args.rig or 'its rig file'}: {done.trip}")
    return 0
