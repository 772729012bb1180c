"""The one next step after a diagnosis or a change: where the structure sits, what to record, and the command."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from estimator.change import Change, Kind
from estimator.diagnosis import Diagnosis, Remainder

SESSION = "legid excite --rig RIG --model MODEL.json --session NEXT"
APART = ("Record what tells the causes apart: legid excite --rig RIG --model MODEL.json --next DIAGNOSIS.json "
         "--session NEXT")
RECORD = {
    "session": ("the time since the start", "Record the same plan cold and warm, in the order of recording", SESSION),
    "time": ("the time within a run", "Record the same plan cold and warm, in the order of recording", SESSION),
    "u": ("the motor's torque", "Hold a known weight at several torques",
          "legid excite --rig RIG --holds 5 --out PLAN"),
    "a": ("the acceleration", "Record fast motion, and declare rotor_inertia = [{j}] under [terms] where the motor is "
          "geared", SESSION),
    "other": ("the motion of the other joint", "Lock one joint in some runs and the other in others", SESSION),
    "v": ("the speed", "Record slow ramps with holds and fast motion as separate runs", SESSION),
    "q": ("the angle", "Record slow motion over the whole range", SESSION)}
"""What a residual depends on -> its name, what to do, and the command."""
MOST_RUNS = 12
"""Names of runs that a next step repeats."""
SENSORS = {"gyro": "legid calibrate imu --rig RIG", "accel": "legid calibrate imu --rig RIG",
           "encoder": "legid doctor --rig RIG"}
"""Start of a channel that reads wrongly -> the command that checks it."""

EACH = "Fit each run separately: legid fit RUN... --rig RIG --each"
DIAGNOSE = "Find what the model lacks: legid diagnose RUN... --rig RIG --html diagnosis.html"
VALIDATE = "Validate the model on new runs: legid validate MODEL.json NEW_RUN... --rig RIG"
SIMULATE = "Simulate a plan: legid simulate MODEL.json --plan PLAN --out NEW_RUN.csv"
FIT = "legid fit RUN... --rig RIG --model-out MODEL.json"
ACTIONS: dict[Kind, str] = {
    "parameters": f"Fit the model to the new runs: {FIT}",
    "mechanics": f"Inspect the joint. Then fit the model to the new runs: {FIT}",
    "sensors": "Check that sensor: legid doctor --rig RIG", "timing": "Check both clocks: legid doctor --rig RIG",
    "environment": "Check how the stand is fixed", "noise": "Check the cable of that sensor: legid doctor --rig RIG"}


@dataclass(frozen=True)
class Files:
    """Files that a command was given, or writes: their names stand in its next step."""

    runs: Sequence[str] = ()
    rig: str | None = None
    """None where the runs hold it."""
    model: str | None = None
    document: str | None = None
    """The JSON of a diagnosis."""


def with_names(step: str, files: Files | None) -> str:
    """A next step with the names of `files` in place of RUN..., RIG, MODEL.json and DIAGNOSIS.json."""
    if files is None:
        return step
    if files.model is not None:  # it is written already
        step = re.sub(r"legid diagnose RUN\.\.\. --rig RIG --model-out MODEL\.json, then ", "", step)
    if files.rig is None:
        step = re.sub(r"(legid (?:fit|diagnose|validate)[^:]*?) --rig RIG", r"\1", step)
    runs = shlex.join(files.runs) if 0 < len(files.runs) <= MOST_RUNS else None
    for place, name in ((r"(?<!NEW_)\bRUN\.\.\.", runs), (r"\bRIG\b", files.rig and shlex.quote(files.rig)),
                        (r"\bMODEL\.json", files.model and shlex.quote(files.model)),
                        (r"\bDIAGNOSIS\.json", files.document and shlex.quote(files.document))):
        if name:
            step = re.sub(place, name.replace("\\", r"\\"), step)
    return step


def next_step(diagnosis: Diagnosis) -> str:
    """One line: place, action and command."""
    if diagnosis.verdict == "fit_failed":
        return EACH
    if diagnosis.verdict == "none":
        return VALIDATE
    if diagnosis.verdict == "named":
        return ("Validate the extended model on new runs: legid diagnose RUN... --rig RIG --model-out MODEL.json, then "
                "legid validate MODEL.json NEW_RUN... --rig RIG")
    if diagnosis.verdict == "one_of" or diagnosis.remainder is None:
        return (APART if diagnosis.causes else
                f"Record slow motion, fast motion, holds and free swings as separate runs: {SESSION}")
    return _of_remainder(diagnosis.remainder)


def variable_of(law: str) -> str:
    """The key of `RECORD` for what a residual is a function of, as a diagnosis writes it: "q sign v", "session"."""
    for key, pattern in (("session", r"session"), ("time", r"time"), ("other", r"other"), ("u", r"\bu\b"),
                         ("a", r"\ba[12]?\b"), ("v", r"v[12]?\b")):
        if re.search(pattern, law):
            return key
    return "q"


def _of_remainder(left: Remainder) -> str:
    command = next((c for start, c in SENSORS.items() if left.channel.startswith(start)), "")
    variable, action, session = RECORD[variable_of(left.depends_on)]
    if command:
        return f"The residual is in {left.channel} and depends on {variable}. Check that sensor: {command}"
    joint = left.joint or 1
    return (f"The residual torque is at joint {joint} and depends on {variable} ({left.depends_on}). "
            f"{action.format(j=joint)}: {session}")


def next_of_change(change: Change) -> str:
    """One line: what to do, and the command."""
    if change.verdict == "fit_failed":
        return EACH
    if change.verdict == "no_change":
        return "Go on with the model that you have; more or longer runs show smaller changes"
    if change.verdict == "changed_unexplained":
        return DIAGNOSE
    if change.verdict == "one_of":
        return APART
    return ACTIONS[change.causes[0].kind]
