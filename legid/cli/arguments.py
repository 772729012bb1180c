"""Arguments that several commands share, and readers of their values."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from math import inf

from legid.cli.command import argument, output


def number(accepted: Callable[[float], bool], what: str) -> Callable[[str], float]:
    """A reader of numbers that are `accepted`, for `type=` of an argument; any other is said to be no `what`."""
    read = numbers(lambda some: len(some) == 1 and accepted(*some), what)
    return lambda text: read(text)[0]


def numbers(accepted: Callable[[tuple[float, ...]], bool], what: str) -> Callable[[str], tuple[float, ...]]:
    """A reader of numbers with commas between them."""

    def read(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if not values or not accepted(values):
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return values

    return read


def whole_number(low: int, high: int, what: str = "a whole number") -> Callable[[str], int]:
    """A reader of whole numbers from `low` to `high`."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low} to {high}")
        return int(text)

    return read


def assignment(text: str) -> tuple[str, float]:
    """NAME=VALUE."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE") from None


HIDEABLE = ("none", "stribeck_friction", "asymmetric_friction", "rotor_inertia", "joint_stiffness", "quadratic_drag",
            "torque_offset", "gyro_bias", "sensor_time_skew")
"""What may be hidden in an emulated leg."""
MOST_WORKERS = 1024
SEED = whole_number(0, 2**20 - 1)
"""A reader of the seed of an emulated leg."""

RUNS = argument("runs", metavar="RUN", nargs="+", help="run files: .mcap, .csv or .csv.gz")
MODEL = argument("model", metavar="MODEL.json", help="a model written by legid fit --model-out")
RIG = argument("--rig", help="the rig's TOML file; default: the one that a run holds, else ./rig.toml")
RIG_ALONE = argument("--rig", help="the rig's TOML file; default: ./rig.toml")
DAMAGED = argument("--damaged", action="store_true",
                   help="use runs of whose files something is missing, too; the documents say which")
AS_READ = argument("--as-read", action="store_true",
                   help="alter and leave out no reading; what is wrong with them is told all the same")
SENSORS = argument("--sensors", choices=("imu", "encoder"),
                   help="what gives the pivot's angle; default: imu where all runs have its columns")
HORIZONS = argument(
    "--horizons", metavar="S,S,...",
    type=numbers(lambda some: all(0.0 < one < inf for one in some), "lengths of time in seconds, such as 0.25,1"),
    help="lengths of the pieces that are simulated [s], besides whole runs; default: 0.1,0.5,1,5")
FIX = argument("--fix", metavar="NAME=VALUE", action="append", default=[], type=assignment,
               help="give a parameter instead of estimating it, e.g. --fix beta8=0; may be repeated")
FORCE = argument("--force", action="store_true",
                 help="replace a file that is there even where it is of another kind; a run never")
HTML = output("--html", "page", help="write a report page")
ESTOP = argument("--estop-at-hand", action="store_true",
                 help="on a drive other than our own firmware: a hard-wired emergency stop is within reach, so do not "
                      "ask")
DRIVE = argument("--drive", metavar="KIND", default="legid",
                 help="what turns the knee: legid (our own firmware, the default), moteus or another drive that has "
                      "an emulator")
