"""`legid calibrate all`: one calibration after another, each with what to do with the leg before it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from daq import InputError, Rig, WorkError, load_rig, parse_rig, set_values
from drivers import DriverError
from estimator import FitError
from experiments.calibrate.motor_off import answer, need_terminal
from experiments.calibrate.outcome import Outcome, store
from experiments.console import text_table


@dataclass(frozen=True)
class Step:
    """One calibration of the walk."""

    name: str
    finds: str
    do: str
    """What the person does before it."""
    device: str
    """Table of [devices] that it reads."""


STEPS = (
    Step("imu", "the gyro's bias", "Let the leg hang still, and keep off the table it stands on.", "imu"),
    Step("mount", "how the IMU sits on link 1, and its lever arm",
         "First the leg hangs still; then you push it, and it swings by 30 degrees or more to either side.", "imu"),
    Step("encoder", "the knee encoder's reading at a straight knee",
         "Several times over you bend the knee, let go, and wait until the leg hangs still.", "controller"),
    Step("shunt", "the offset of the current shunt", "Let the leg hang still.", "controller"),
)
"""In this order: the knee's zero rests on the IMU's angle, and that on the mount and the biases."""
STRAIGHT = "Hold or clamp the leg straight, knee and all."
STOPPED, SKIPPED = "stopped here", "skipped"
SIX = "Take the IMU off: you will lay it on each of its six faces in turn. Put it back afterwards."


def walk(path: str, measure: Mapping[str, Callable[[Rig], Outcome]], dry_run: bool, does: Mapping[str, str]
         ) -> str:
    """Go through `STEPS`, write what each finds into the rig file at `path` at once; returns a summary.

    `measure` holds one measurement a step; `does` overrides what a step asks of the person. With `dry_run` later steps
    go by what earlier ones found, but the file stays as it is. Raises `InputError` without a terminal.
    """
    need_terminal("run this on a terminal, or one step at a time: legid calibrate "
                  f"{' | '.join(step.name for step in STEPS)} RUN...")
    rig, text = load_rig(path), Path(path).read_text(encoding="utf-8")
    print(f"{len(STEPS)} steps, the motor stays off. What is found is written into {path} after each"
          f"{', were this no dry run' if dry_run else ''}.")
    rows = []
    for number, step in enumerate(STEPS, 1):
        print(f"\nStep {number} of {len(STEPS)}, {step.name}: {step.finds}.", flush=True)
        if getattr(rig.devices, step.device) is None:
            print(f"Left out: {path} has no [devices.{step.device}].")
            rows.append([step.name, f"left out, no [devices.{step.device}]"])
            continue
        print(does.get(step.name, step.do))
        outcome, words = _attempts(measure[step.name], rig)
        if outcome is not None:
            print(outcome.text)
            for warning in outcome.warnings:
                print(f"warning: {warning}")
            print(store(outcome, path, dry_run))
            tables = outcome.tables(rig)
            text = set_values(text, tables, path)
            rig = parse_rig(text, path)
            words = "; ".join(f"{key} = {value}" for values in tables.values() for key, value in values.items())
        rows.append([step.name, words or "nothing to write"])
        if words == STOPPED:
            break
    return "\n" + text_table(["step", "dry run: would write" if dry_run else "written"], rows, right=set())


def _attempts(measure: Callable[[Rig], Outcome], rig: Rig) -> tuple[Outcome | None, str]:
    """The outcome, or the word for none: a measurement that fails can be taken again."""
    verb, failed = "begin", ""
    while True:
        said = answer(f"Enter to {verb}, s to skip, q to stop: ").strip().lower()
        if said == "q":
            return None, STOPPED
        if said == "s":
            return None, f"{SKIPPED}: {failed}" if failed else SKIPPED
        if said:
            continue
        try:
            return measure(rig), ""
        except (InputError, WorkError, FitError, DriverError) as error:
            failed = str(error)
        print(f"Not done: {failed}", flush=True)
        verb = "try again"
