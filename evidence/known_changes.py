"""`python -m evidence known-changes`: public records of a machine whose parts were changed on purpose.

The records are no part of the project. `--snapshots DIR` is a folder with a clone of the repository under its own name;
files are taken from the commit that the page names.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evidence.emulated_legs import label
from evidence.frame import Lines, new_folder, program, table
from evidence.kept import kept
from evidence.machines import Row, clones, commands_table, shown, timed
from evidence.registry import Evidence

REPOSITORY, COMMIT = "dfki-ric-underactuated-lab/double_pendulum", "1e8544e67f3da72a51ee52fbbb278e131ce2a43f"
RECORDS = "data/experiment_records"
SESSIONS: Mapping[str, tuple[str, ...]] = {
    "A0": tuple(f"{RECORDS}/design_A.0/20220815/sys_id/trajectory_{k}.csv" for k in ("00", "01", "02", "03", "12")),
    "C0": tuple(f"{RECORDS}/design_C.0/20220914/sys_id/trajectory_{k:02d}.csv" for k in range(7)),
    "C1": tuple(f"{RECORDS}/design_C.1/sys_id/20230629/20230629-{clock}/trajectory.csv" for clock in (
        "143339", "143524", "143601", "143704", "143747", "143906", "144003", "144115", "154220", "154548"))}
COLUMNS = "\n".join(f'[columns.{ours}]\nname = "{theirs}"' for ours, theirs in (
    ("time_s", "time"), ("q1_rad", "pos_meas1"), ("q2_rad", "pos_meas2"), ("tau1_nm", "tau_meas1"),
    ("tau2_nm", "tau_meas2"))) + "\n"
RIG = """[mechanism]
model = "leg2"
actuated = [1, 2]

[terms]
rotor_inertia = [2]
torque_offset = [1, 2]
friction_velocity_radps = 0.05

[motor]
gear_ratio = 6.0

[noise]
encoder_rad = 0.002     # the gear's play, which the encoders on the motors do not see

[sampling]
rate_hz = 25.0
hold = "average"

[filter]
cutoff_hz = 3.0
"""


class Pair(NamedTuple):
    """Two sessions, what the authors changed between them, and what they publish of it."""

    title: str
    sessions: tuple[str, str]
    changed: str
    published: Mapping[str, tuple[float, float]]
    """Quantity -> its value in the first and in the second session."""
    remarks: tuple[str, ...]


PAIRS = (
    Pair("Links of other lengths", ("A0", "C0"),
         "Link 1 is 0.2 m long and not 0.3 m, link 2 is 0.3 m long and not 0.2 m. The drives have the same type.",
         {"length of link 1 [m]": (0.3, 0.2), "length of link 2 [m]": (0.2, 0.3),
          "first moment of link 2, m2 r2 [kg m]": (0.630 * 0.166, 0.563936 * 0.321267),
          "mass of link 2 [kg]": (0.630, 0.563936)},
         ("The links are named. The first moment of link 2 (`beta5`) gains 13 % less than by the authors' values.",
          "An elastic joint is named, too, but the interval of its compliance contains zero. Its other sizes are a "
          "drive's inertia and friction.")),
    Pair("The same design built anew", ("C0", "C1"),
         "Links of the same lengths on new hardware, nine months later. The authors identified both builds.",
         {"first moment of link 2, m2 r2 [kg m]": (0.563936 * 0.321267, 0.625568 * 0.255693),
          "mass of link 2 [kg]": (0.563936, 0.625568),
          "Coulomb friction of joint 1 [N m]": (0.093 * 1.5708, 0.16 * 1.5708),
          "Coulomb friction of joint 2 [N m]": (0.078 * 1.5708, 0.12 * 1.5708)},
         ("The friction that joint 1 gained is found under the name of an elastic joint. Its `motor_coulomb` agrees "
          "with the authors' values.",
          "The first moment that link 2 lost is not found. The sentence says that something else is left.")))


class Said(NamedTuple):
    """What came of a pair's commands."""

    rows: Sequence[Row]
    document: dict[str, Any]
    """The pair in the comparison's JSON; empty without one"""


@kept
def compared(pair: Pair, snapshot: Path) -> Said:
    """The pair's commands, typed in a new folder."""
    rows, a, b = [], *pair.sessions
    with new_folder() as folder:
        (folder / "rig.toml").write_text(RIG)
        (folder / "columns.toml").write_text(COLUMNS)
        for session in (a, b):
            (folder / session).mkdir()
            for k, path in enumerate(SESSIONS[session]):
                (folder / session / f"{k:02d}.csv").write_bytes(shown(snapshot, COMMIT, path))
        for command in (f"legid import {a}/*.csv --out runs{a} --map columns.toml",
                        f"legid import {b}/*.csv --out runs{b} --map columns.toml",
                        f"legid compare runs{a} runs{b} --rig rig.toml --json compare.json"):
            rows.append(timed(command, folder))
        out = folder / "compare.json"
        return Said(rows, json.loads(out.read_bytes())["pairs"][0] if out.exists() else {})


def page(snapshots: str = "") -> Lines:
    (place,) = clones(snapshots, [REPOSITORY])
    yield from [
        "# Known changes of a public machine",
        f"[{REPOSITORY}](https://github.com/{REPOSITORY}), commit `{COMMIT[:10]}`, licence: BSD-3-Clause. A double "
        "pendulum with two motors and encoders was recorded in three designs. The files `model_parameters.yml` below "
        "`data/system_identification/identified_parameters` say what differs. The records are no part of the project.",
        "The rig file, and the map by hand:", f"```toml\n{RIG}```", f"```toml\n{COLUMNS}```"]
    for number, pair in enumerate(PAIRS, 1):
        said = compared(pair, place)
        yield from [f"## {number}. {pair.title}", f"From {pair.sessions[0]} to {pair.sessions[1]}. {pair.changed}"]
        yield commands_table(said.rows)
        yield table("cause | size | value | 95 % interval", (
            f"{label(cause['effect'], cause['joint'])} | {size['name']} [{size['unit']}] | {size['value']:.3g} | "
            f"{size['ci95'][0]:.3g} to {size['ci95'][1]:.3g}"
            for cause in said.document.get("causes", ()) for size in cause["size"]))
        yield table("published | before | after | change", (
            f"{name} | {before:.3g} | {after:.3g} | {after - before:+.3g}"
            for name, (before, after) in pair.published.items()))
        yield from (f"- {remark}" for remark in pair.remarks)


def verdicts(text: str) -> str:
    """The result for the index: the answer to each pair."""
    said = [line.split(" | ")[-1].rstrip(" |") for line in text.splitlines() if line.startswith("| `legid compare")]
    return "; ".join(one.split(", and something else")[0] for one in said)


EVIDENCE = Evidence(
    "Public records of a machine whose links were changed, and of one built anew",
    "python -m evidence known-changes", "known-changes.md", 4, "the change is named", verdicts)
main = program(page)
