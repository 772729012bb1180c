"""A family that no engine made: real records with a fault put into their readings by hand.

What a sensor does wrong can be put into a record exactly, whatever the machine does besides. The untouched record is
diagnosed too: what changes against it is what was put in. The rig files are those with which `legid casebook` diagnoses
these machines; records and their published answers stay in ../shared/realdata.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evidence.blind.score import PRESENT, Outcome, same
from evidence.blind.servo import Readings, effect, of_case, off_centre
from evidence.frame import share, table
from tests.support.paths import REAL, ROOT

RIGS = ROOT / "studies/rigs"
UNTOUCHED = "untouched"
COMMANDS = {"goal_rad": "q1_cmd_rad"}
"""Column of a record to that of the contract."""


@dataclass(frozen=True)
class Record:
    """Runs of one machine, and which columns hold what."""

    folder: str
    runs: tuple[str, ...]
    rig: str
    angle: str
    torque: tuple[str, ...]
    joint: int
    """Of the angle that is spoilt."""
    sizes: Mapping[str, float]
    """What is put in, of ordinary strength, by effect."""


class Fault(NamedTuple):
    """A fault of a reading: name of its size, and what it does to the columns of a record's runs."""

    size: str
    per_joint: bool
    put_in: Callable[[Sequence[Readings], Record, float], None]


def _angle(law: Callable[[np.ndarray, float], np.ndarray]) -> Callable[[Sequence[Readings], Record, float], None]:
    """A fault of the angle in each run."""
    def put_in(runs: Sequence[Readings], record: Record, size: float) -> None:
        for c in runs:
            c[record.angle] = law(c[record.angle], size)

    return put_in


def _late(runs: Sequence[Readings], record: Record, size: float) -> None:
    for c in runs:
        for name in record.torque:
            c[name] = np.interp(c["time_s"] - size, c["time_s"], c[name])


def _saturated(runs: Sequence[Readings], record: Record, size: float) -> None:
    """Each motor gives less than the current says, by a fifth power: not the library's law. It is one law in all runs:
    the current is measured against its largest value in any of them."""
    for name in record.torque:
        most = max(np.abs(c[name]).max() for c in runs)
        for c in runs:
            c[name] = c[name] * (1.0 + size * (c[name] / most) ** 4)


FAULTS = {"torque_delay": Fault("delay", False, _late), "torque_saturation": Fault("", False, _saturated),
          "encoder_offset": Fault("offset", True, _angle(lambda q, size: q + size)),
          "encoder_scale": Fault("scale_error", True, _angle(lambda q, size: q * (1.0 + size))),
          "encoder_eccentricity": Fault("", True, _angle(lambda q, size: q + off_centre(q, size)))}
ARM = {"torque_delay": 0.02, "torque_saturation": 0.3, "encoder_offset": 0.15, "encoder_scale": 0.08,
       "encoder_eccentricity": 0.12}
RECORDS = {
    "c0": Record("dfki_c0", ("00", "01", "02", "03", "04", "05", "06"), "dfki_diagnose.toml", "q2_rad",
                 ("tau1_nm", "tau2_nm"), 2, ARM),
    "a0": Record("dfki_a0", ("00", "01", "02", "03", "12"), "dfki_diagnose.toml", "q2_rad",
                 ("tau1_nm", "tau2_nm"), 2, ARM),
    "servo": Record("bam_xl330", tuple(f"kp{k}_{m}" for k in (100, 400) for m in (
        "lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")), "bam_xl330_diagnose.toml", "q1_rad",
        ("duty",), 1, {"torque_delay": 0.03, "torque_saturation": 0.4, "encoder_scale": 0.1,
                       "encoder_eccentricity": 0.15}),
    # its scale and its mass are one number, and no gravity tells of a zero
    "axis": Record("emps", ("estimation",), "emps_diagnose.toml", "q1_m", ("tau1_n",), 1,
                   {"torque_delay": 0.004, "torque_saturation": 0.2})}
NAMES = tuple(f"{record}.{fault}" for record, r in RECORDS.items() for fault in (UNTOUCHED, *r.sizes))


def make_case(name: str, seed: int, out: Path) -> None:
    """r1.csv, ... and rig.toml in OUT/NAME-SEED, its truth next to that folder."""
    key, fault = name.split(".")
    record = RECORDS[key]
    size = record.sizes.get(fault, 0.0) * of_case(name, seed, 5).uniform(0.7, 1.3)
    folder = out / f"{name}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    tables = [np.genfromtxt(REAL / record.folder / f"{run}.csv.gz", delimiter=",", names=True) for run in record.runs]
    runs = [{COMMANDS.get(n, n): np.array(table[n]) for n in table.dtype.names or ()} for table in tables]
    if fault != UNTOUCHED:
        FAULTS[fault].put_in(runs, record, size)
    for k, columns in enumerate(runs, 1):
        np.savetxt(folder / f"r{k}.csv", np.column_stack(list(columns.values())), delimiter=",",
                   header=",".join(columns), comments="", fmt="%.12g")
    (folder / "rig.toml").write_bytes((RIGS / record.rig).read_bytes())
    truth: dict[str, Any] = {"name": folder.name, "effects": [], "seed": seed}
    if fault != UNTOUCHED:
        named = {FAULTS[fault].size: size} if FAULTS[fault].size else {}
        truth["effects"] = effect(fault, record.joint if FAULTS[fault].per_joint else None, **named)
    (out / f"{folder.name}.truth.json").write_text(json.dumps(truth))


def compare(outcomes: Sequence[Outcome], answers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The page's rates and rows: what is said of every spoilt record beside what is said of the same one untouched;
    `answers` are the diagnosis JSONs by case."""
    plain = {o.truth["name"].split(".")[0]: o for o in outcomes if not o.hidden}
    rows, sized = [], []
    by_record: dict[str, list[bool]] = {}
    for o in outcomes:
        if not o.hidden:
            continue
        record, fault = o.truth["name"].rsplit("-", 1)[0].split(".")
        before = plain.get(record)
        if before is None:
            rows.append(f"{record} | {fault} | no answer yet | {o.said} | - | - | -")
            continue
        size, told = next(iter(o.hidden[0]["sizes"].values()), None), _size(o, o.hidden[0])
        already = size_before(answers[before.truth["name"]], o.hidden[0])
        inside = None if told is None or size is None else bool(told[1] <= size + already <= told[2])
        by_record.setdefault(record, []).append(is_found(o, before, inside))
        sized += [] if inside is None else [inside]
        put_in = "-" if size is None else f"{already:.3g} + {size:.3g}"
        size_found = "-" if told is None else f"{told[0]:.3g} [{told[1]:.3g}, {told[2]:.3g}]"
        error = answers[o.truth["name"]].get("error")
        errors = "-" if not error else f"{error['before']:.2f}, {error['after']:.2f}"
        rows.append(f"{record} | {fault} | {before.said} | {o.said} | {put_in} | {size_found} | {errors}")
    return [table(" | measured", [
        f"named or in the set | {share(one for own in by_record.values() for one in own)}",
        *(f"of these on {one} | {share(own)}" for one, own in sorted(by_record.items())),
        f"size inside its 95 % interval | {share(sized)}"]),
        table("record | fault | untouched | spoilt | there + put in | found | rms error before, after", rows)]


def is_found(spoilt: Outcome, plain: Outcome, inside: bool | None) -> bool:
    """Whether what was put in is said to be there, and was not without it, or by as much less, its size `inside`."""
    hidden = spoilt.hidden[0]
    if spoilt.verdict not in PRESENT or not spoilt.found(hidden):
        return False
    return not (plain.verdict in PRESENT and plain.found(hidden)) or inside is True


def size_before(answer: Mapping[str, Any], hidden: Mapping[str, Any]) -> float:
    """What the untouched record says of that effect: as a cause, or as scored one by one; nil where it is not tried.

    Nobody knows a real machine's own faults, and a fault put in adds to them.
    """
    for cause in (*answer["causes"], *answer.get("immaterial", ())):
        if same(cause, hidden):
            return float(cause["size"][0]["value"])
    return next((float(c["size"]) for c in answer.get("candidates", ()) if same(c, hidden)), 0.0)


def _size(outcome: Outcome, hidden: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """First size of that effect with its interval, as far as it is said to be there."""
    if outcome.verdict not in PRESENT:
        return None
    for cause in outcome.causes:
        if same(cause, hidden):
            return (cause["size"][0]["value"], *cause["size"][0]["ci95"])
    return None
