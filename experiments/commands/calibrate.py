"""`legid calibrate imu`: bias, noise and scales of the IMU, from records at rest."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from daq.imu_calibration import StillRecord
    from daq.rig import Rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "calibrate", help="calibrate the IMU from records at rest",
        description="Gyro bias and noise (Allan deviation) from a record of an IMU that lies still; with six, each "
                    "with another axis of the chip up or down, accelerometer bias and scales too. Without RUN the chip "
                    "itself is read. The result goes into the [calibration] table of the rig file.")
    parser.add_argument("what", choices=["imu"], help="what to calibrate")
    parser.add_argument("runs", metavar="RUN", nargs="*", help="one or six .mcap files recorded at rest")
    parser.add_argument("--rig", required=True, help="the rig's TOML file; its [calibration] is written")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each record from the chip (default 60)")
    parser.add_argument("--six-positions", action="store_true", help="ask for six positions of the chip, one by one")
    parser.add_argument("--self-test", action="store_true", help="first let the chip test itself; keep it still")
    parser.add_argument("--dry-run", action="store_true", help="print only, leave the rig file as it is")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure, say, store."""
    from pathlib import Path

    from daq.errors import InputError
    from daq.rig import load_rig
    from daq.rig_text import set_calibration
    from experiments import calibrating

    rig = load_rig(args.rig)
    text = Path(args.rig).read_text(encoding="utf-8")
    records = _recorded(args.runs) if args.runs else _measured(args, rig)
    gyro, accel = calibrating.calibrate(records, rig.mechanism.gravity_mps2)
    values = calibrating.calibration_values(gyro, accel)
    print(calibrating.calibration_text(gyro, accel))
    if args.dry_run:
        print(f"{args.rig} left as it is; it would say:")
        print("\n".join(f"  {key} = {value}" for key, value in values.items()))
        return 0
    new = set_calibration(text, values, args.rig)
    try:
        Path(args.rig).write_text(new, encoding="utf-8")
    except OSError as error:
        raise InputError(args.rig, error.strerror or str(error), "give a place that can be written") from None
    print(f"{args.rig}: [calibration] {', '.join(values)} written")
    return 0


def _recorded(paths: Sequence[str]) -> list[StillRecord]:
    """Still records from run files."""
    from daq.errors import InputError
    from daq.imu_calibration import still_record
    from daq.runfile import read_run
    from experiments.calibrating import SIX

    if len(paths) not in (1, SIX):
        raise InputError("RUN", f"{len(paths)} files given", "give one still record, or six for six positions")
    return [still_record(read_run(path)) for path in paths]


def _measured(args: argparse.Namespace, rig: Rig) -> list[StillRecord]:
    """Still records from the chip."""
    from daq.errors import InputError, WorkError
    from experiments.calibrating import SIX, record_still, self_test_text
    from experiments.devices import open_imu

    if rig.devices.imu is None:
        raise InputError(args.rig, "has no [devices.imu]", "describe the IMU, or give records as RUN")
    records = []
    with open_imu(rig.devices.imu, args.rig) as imu:
        if args.self_test:
            words, passed = self_test_text(imu.bus, rig.devices.imu)
            print(words)
            if not passed:
                raise WorkError("the IMU's self-test failed; the chip is damaged, or it moved meanwhile")
            imu.open()
        for position in range(SIX if args.six_positions else 1):
            if args.six_positions:
                input(f"position {position + 1} of {SIX}: lay the chip on another face, then press Enter ")
            print(f"keep still for {args.seconds:g} s", flush=True)
            records.append(record_still(imu, args.seconds, f"record {position + 1}"))
    return records
