"""`make structure`: what is the structure of a residual worth where no listed effect explains it?

The servo's legs of the blind bench hide causes that the library lacks. `legid diagnose` answers each as a user would
have it, and so it does public records. The errors are those of free runs on runs that did not teach the structure.
What is in the folder already is kept, so the command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daq import load_rig
from evidence.blind import servo
from evidence.blind.run import COMMAND, parse_seeds
from evidence.registry import Evidence, found
from studies import machine
from tests.support.paths import ROOT

CAUSES = ("outside_magnet", "outside_cubic_spring", "outside_patchy_friction")
HIDDEN = {"outside_magnet": "a magnet near the pivot's middle: joint 1, angle",
          "outside_cubic_spring": "a cubic spring: joint 2, angle",
          "outside_patchy_friction": "friction that varies with the angle: joint 2, angle and direction"}

SOURCES = {"bam_xl330": "[Rhoban/bam](https://github.com/Rhoban/bam), a servo with a pendulum, commit `af22604622`",
           "dfki_c0": "[dfki-ric-underactuated-lab/double_pendulum](https://github.com/dfki-ric-underactuated-lab/"
                      "double_pendulum), design C.0"}
"""Of public records, which are no part of the project."""


def answer(name: str, rig: Path, runs: Sequence[Path], out: Path) -> dict[str, Any]:
    """The diagnosis JSON of some runs, kept in OUT with its MODEL.json."""
    document = out / f"{name}.json"
    if not document.exists():
        part = out / f"{name}.part.json"
        part.unlink(missing_ok=True)
        subprocess.run([*COMMAND, "diagnose", *map(str, runs), "--rig", str(rig), "--json", str(part), "--model-out",
                        str(out / f"{name}.model.json"), "--force"], check=False, stdout=subprocess.DEVNULL, cwd=ROOT)
        part.rename(document)
    told: dict[str, Any] = json.loads(document.read_text(encoding="utf-8"))
    return told


def row(name: str, hidden: str, diagnosis: Mapping[str, Any]) -> str:
    """One line of the table."""
    told = diagnosis.get("structure")
    if told is None:
        share = re.search(r"learnt as functions of the state remove (.*?\])", " ".join(diagnosis["warnings"]))
        what = f"{share[1].replace('%', ' %')}, not offered" if share else "nothing is learnt"
        return f"| {name} | {hidden} | {diagnosis['verdict']} | {what} | | |"
    low, high = told["removed_ci95"]
    where = "; ".join(f"joint {w['joint']}, {w['depends_on']} ({w['rms_nm']:.2g} N m)" for w in told["where"][:3])
    errors = "; ".join(f"{e['channel']} {_text(e['before'])}, {_text(e['after'])}" for e in told["error"]
                       if e["horizon_s"] is None)
    return (f"| {name} | {hidden} | {diagnosis['verdict']} | {100 * told['removed']:.0f} % [{100 * low:.0f}, "
            f"{100 * high:.0f}] | {where} | {errors} |")


def _text(value: float | None) -> str:
    return "diverges" if value is None else f"{value:.3g}"


def page(seeds: Sequence[int], records: Sequence[Path], out: Path) -> Iterator[str]:
    """The page, line by line."""
    (out / "diagnoses").mkdir(parents=True, exist_ok=True)
    rows, offered = [], 0
    for seed in seeds:
        for cause in CAUSES:
            servo.make_case(cause, seed, out / "cases")
            folder = out / "cases" / f"{cause}-{seed}"
            told = answer(folder.name, folder / "rig.toml", sorted(folder.glob("r*.csv")), out / "diagnoses")
            offered += told.get("structure") is not None
            rows.append(row(folder.name.removeprefix("outside_"), HIDDEN[cause], told))
            print(rows[-1], flush=True)
    for folder in records:
        runs = sorted(p for p in folder.glob("*.csv.gz") if "passive" not in p.name)
        rig = folder / "rig.toml"
        name = f"{folder.name}, {load_rig(rig).sampling.rate_hz:g} Hz"
        rows.append(row(name, "not known", answer(folder.name, rig, runs, out / "diagnoses")))
        print(rows[-1], flush=True)
    count = len(seeds) * len(CAUSES)
    yield from [
        "# Structure without a listed cause", "",
        f"Made by `make structure` (seeds {', '.join(map(str, seeds))}), {datetime.now(UTC):%Y-%m-%d}, {machine()}.",
        "", "`legid diagnose` answers legs of MuJoCo under a position servo that hide a cause outside the library, and "
        "public records. If it ends `unexplained` or `partial`, it learns the torque that the model leaves as a "
        "function of the state. Each run is left out once, and does not teach the structure that simulates it. "
        "Removed is the share of the rms error of free runs, with its 95 % interval over the runs. The error is that "
        "of all sensors, over 0.1 s, 1 s and the whole run.", "",
        f"A structure is offered for {offered} of {count} hidden causes.", "",
        "| runs | hidden | verdict | removed [%] | place | whole runs, rms error before, after |",
        "| --- | --- | --- | --- | --- | --- |", *rows, "",
        "Angles are in rad, gyro and rates in rad/s.", "",
        *(f"- `{folder.name}`: {SOURCES[folder.name]}." for folder in records if folder.name in SOURCES), ""]


def removed(text: str) -> str:
    """The index's sentence: how many are offered, and what each removes."""
    offered = found(r"A structure is (offered for \d+ of \d+ hidden causes)", text)
    each = re.findall(r"^\| (\w+?)-\d+ \|[^|]*\|[^|]*\| ([^|]*%[^|]*) \|", text, re.MULTILINE)
    if offered is None:
        raise ValueError("the page does not say how many structures are offered")
    return "; ".join([offered, *(f"{name} {share}" for name, share in each)])


EVIDENCE = (
    Evidence("Structure without a listed cause: what does it remove of the error on left-out runs?", "make structure",
             "structure.md", 15, "offered for each hidden cause, more than half of the error removed", removed),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=parse_seeds, default=[56], help="N or A-B, several after commas")
    parser.add_argument("--records", type=Path, nargs="*", default=[], help="folders with rig.toml and *.csv.gz")
    parser.add_argument("--folder", type=Path, required=True, help="cases and answers, kept")
    parser.add_argument("--out", type=Path, required=True, help="the page")
    args = parser.parse_args(arguments)
    args.out.write_text("\n".join(page(args.seeds, args.records, args.folder)), encoding="utf-8")
