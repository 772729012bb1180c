"""`python -m tests.evidence five-machines`: public records of machines that we did not build, through typed commands.

The records are no part of the project. `--snapshots DIR` is a folder with a clone of each repository under its own
name; files are taken from the commit that the page names.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from experiments.studies import machine
from tests.evidence.kept import kept
from tests.evidence.registry import Evidence
from tests.support.paths import ROOT

JOINT = '[mechanism]\nmodel = "joint1"\nactuated = [1]\n'
LONGEST = 170
"""Characters of a message that the page shows."""


@dataclass(frozen=True)
class Machine:
    """A repository, its records, what a person types, and what the authors publish."""

    title: str
    repository: str
    commit: str
    licence: str
    files: Mapping[str, str]
    """Name that a person gives -> path in the repository."""
    rig: str
    commands: tuple[str, ...]
    """At most five."""
    published: Mapping[str, float]
    """Of the parameters in fit.json."""
    source: str
    """Of what is published."""
    remarks: tuple[str, ...]
    columns: str = ""
    """columns.toml, where a person has to write it."""


def column_map(names: Mapping[str, str]) -> str:
    """columns.toml: run's column -> lines of its entry."""
    return "\n".join(f"[columns.{column}]\n{lines}" for column, lines in names.items()) + "\n"


def fits(runs: str, more: str = "") -> str:
    return f"legid fit {runs} --rig rig.toml {more}--json fit.json --model-out model.json"


MACHINES = (
    Machine(
        "Geared pendulum", "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
        "ed17ea2d32a35ad944944ca03ef57693e2986732", "BSD-3-Clause",
        {"ddp.csv": "results/control_method_ddp/data_measured.csv",
         "collocation.csv": "results/control_method_direct_collocation/data_measured.csv",
         "identification.csv": "results/control_method_pd/system_identification/data_measured.csv"},
        JOINT,
        ("legid import ddp.csv collocation.csv identification.csv --out runs --yes",
         "legid fit runs/identification.csv --rig rig.toml",
         fits("runs/ddp.csv"),
         "legid validate model.json runs/collocation.csv --rig rig.toml",
         "legid diagnose runs/ddp.csv runs/collocation.csv --rig rig.toml"),
        {"beta1": 0.150, "beta2": 0.304}, "masses and lengths of hardware/testbench_description.md, rotor included",
        ("The authors identified 0.063 kg m² and 0.102 kg m from `identification.csv` by least squares. Its torque "
         "jumps by 17 N m between samples. legid does not trust that record.",
         "Both parameters are 1.2 times those of the drawing, and their ratio is right. A wrong torque scale does "
         "that, and legid says that it cannot see one.")),
    Machine(
        "Brachiating robot of two links, AcroMonk", "dfki-ric-underactuated-lab/acromonk",
        "ea0b53d2ac50cf6ac2939ffa207c0790be5f3baa", "BSD-3-Clause",
        {f"{name}.csv": f"results/real_system/csvs/{name}.csv" for name in (
            "ZF_pd_1x", "ZB_pd_1x", "BF_tvlqr_1x", "ZF_tvlqr_1x")},
        '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[sampling]\nrate_hz = 50.0\n',
        ("legid import ZF_pd_1x.csv ZB_pd_1x.csv BF_tvlqr_1x.csv ZF_tvlqr_1x.csv --out runs --yes",
         "legid import ZF_pd_1x.csv ZB_pd_1x.csv BF_tvlqr_1x.csv ZF_tvlqr_1x.csv --out runs --map runs/columns.toml",
         fits("runs/ZF_pd_1x.csv runs/ZB_pd_1x.csv runs/BF_tvlqr_1x.csv", "--fix beta4=0.431 "),
         "legid validate model.json runs/ZF_tvlqr_1x.csv --rig rig.toml",
         "legid diagnose runs/ZF_pd_1x.csv runs/ZB_pd_1x.csv runs/BF_tvlqr_1x.csv --rig rig.toml --fix beta4=0.431"),
        {"beta1": 0.1175, "beta2": 0.0132, "beta3": 0.0232, "beta5": 0.0738},
        "CAD values of data/simulation_models/acromonk.urdf, hooks included",
        ("The guess was right and did not trust itself: one swing leaves half of the torque unexplained.",
         "Without a known value the fit writes no model and asks for one: beta4, or the length l1.",
         "At the default 100 Hz the diagnosis is refused, and the message names `rate_hz`.")),
    Machine(
        "Brachiating robot of three bodies, RicMonk", "dfki-ric-underactuated-lab/ricmonk",
        "05b19cf011708f179049383e8507a8645fe1848c", "BSD-3-Clause",
        {f"{name}.csv": f"results/singleBrachiation_tvlqr/TVLQR_{name}/measured.csv"
         for name in ("ZF", "ZB", "BF", "FB")},
        '[mechanism]\nmodel = "chain"\nlinks = 3\nactuated = [2, 3]\n[sampling]\nrate_hz = 50.0\n'
        "[prior]\nl1 = [0.314, 0.001]      # by the CAD file\nl2 = [0.0, 0.0005]       # two joints on one axis\n",
        ("legid import ZF.csv ZB.csv BF.csv FB.csv --out runs --yes",
         "legid import ZF.csv ZB.csv BF.csv FB.csv --out runs --map runs/columns.toml",
         fits("runs/ZF.csv runs/ZB.csv runs/BF.csv"),
         "legid validate model.json runs/FB.csv --rig rig.toml",
         "legid diagnose runs/ZF.csv runs/ZB.csv runs/BF.csv runs/FB.csv --rig rig.toml"),
        {"beta1": 0.300, "beta2": 0.0928, "beta3": 0.0231, "beta4": 0.151, "beta5": 0.0228, "beta7": 0.977,
         "beta8": 0.480, "beta9": 0.0726},
        "CAD values of data/simulation_models/finalRicMonkCurrent.urdf, hooks included",
        ("The columns were guessed right, without trust. `arm2` is the sum of `tail` and `phi`, so it is left out.",
         "Four values of the heavy bodies agree with CAD. The tail's own inertia is 1.8 times CAD's, which has no "
         "rotor. Values of the light second arm are a third too small.",
         "The validation on the 2 s of `FB.csv` was refused for a column that is right. Since 2026-11-25 it runs: a "
         "free run of 2 s fits the first two angles to 54 and 60 %, the third not at all.")),
    Machine(
        "Joint 2 of a UR10e", "shamilmamedov/dynamic_calibration",
        "11af40e7deb758ec080a175fed8fcdd6c99aca29", "none stated",
        {"joint_2.csv": "dataset_ur10e/jointwise_motion/ur-20_01_22-joint_2.csv"},
        JOINT,
        ("legid import joint_2.csv --out runs",
         "legid import joint_2.csv --map columns.toml --out runs",
         fits("runs/joint_2.csv"),
         "legid diagnose runs/joint_2.csv --rig rig.toml"),
        {"beta1": 18.2, "beta2": 11.4, "beta3": 20.2, "beta4": 13.3},
        "drive gain, bodies, rotor and friction identified by the authors, UR10E_parameters.txt, arm straight",
        ("The table has no header. `utils/data_processing/parseURData.m` names its columns.",
         "By the URDF's masses the first moment is 12.6 kg m, and by the controller's torque, column 27, 12.8. The "
         "authors' gain is too small, then, which no motion shows."),
        column_map({"time_s": 'name = "column 1"', "q1_rad": 'name = "column 3"\noffset = -1.5707963   # 0 is hanging',
                    "tau1_nm": 'name = "column 15"\nunit = "A"\nscale = 10.6956         # N m per A'})),
    Machine(
        "Pendulum of a textbook's rotary servo", "Prof-Carter/book_ip",
        "7d5e476f404a7c83ac251f112998b723c586a05e", "none stated",
        {"adip_pend_data.mat": "mfiles/p1c3/adip_pend_data.mat"},
        '[mechanism]\nmodel = "joint1"\nactuated = []     # it swings freely\n',
        ("legid import adip_pend_data.mat --out runs --yes --span 50,66",
         fits("runs/adip_pend_data.csv", "--fix beta2=0.01872 "),
         "legid diagnose runs/adip_pend_data.csv --rig rig.toml --fix beta2=0.01872"),
        {"beta1": 0.004556, "beta3": 0.000101}, "J2 + m2 l2², mu2 in ip_toolbox_1.0.2/iptools/adip_para.m",
        ("The book fits seconds 50 to 66 as well. Of all 120 s, a hand at the start leaves no friction to be found.",
         "m2 l2 = 0.096 kg × 0.195 m is given, since a free swing shows ratios only.")),
)


@dataclass
class Session:
    """What came of a machine's commands."""

    rows: list[tuple[str, float, int, str]] = field(default_factory=list)
    """Command, seconds, exit status, the sentence that answers."""
    parameters: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Name -> value and 95 % interval, of those determined."""


@kept
def session(one: Machine, snapshot: Path) -> Session:
    """Every command of one machine, typed in a new folder."""
    out = Session()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "rig.toml").write_text(one.rig)
        if one.columns:
            (folder / "columns.toml").write_text(one.columns)
        for name, path in one.files.items():
            (folder / name).write_bytes(subprocess.run(["git", "-C", str(snapshot), "show", f"{one.commit}:{path}"],
                                                       check=True, capture_output=True).stdout)
        for command in one.commands:
            began = time.monotonic()
            done = subprocess.run([sys.executable, "-m", "experiments.cli", *shlex.split(command)[1:]], cwd=folder,
                                  capture_output=True, text=True, env={"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})
            out.rows.append((command, time.monotonic() - began, done.returncode, answer(command, done)))
            print(*out.rows[-1], sep=" | ", flush=True)
        if (folder / "fit.json").exists():
            for p in json.loads((folder / "fit.json").read_bytes())["parameters"]:
                if p["value"] is not None and p["ci95"] is not None:
                    out.parameters[p["name"]] = (p["value"], *p["ci95"])
    return out


def answer(command: str, done: subprocess.CompletedProcess[str]) -> str:
    """The line that a person reads first: the error, else the verdict, else what was written."""
    said = [line for line in done.stdout.splitlines() if line]
    refused = [line for line in done.stderr.splitlines() if line.startswith("legid ")]
    if command.startswith("legid import"):
        written = sum("samples at" in line for line in said)
        line = refused[-1] if refused else f"{written} runs written" if written > 1 else said[-1]
    else:
        line = said[0] if said and done.returncode == 0 else (refused or said)[-1]
    return line if len(line) <= LONGEST else line[:LONGEST].rsplit(" ", 1)[0] + " ..."


def page(snapshots: Path) -> Iterator[str]:
    """The page, line by line."""
    found = [session(one, snapshots / one.repository.split("/")[1]) for one in MACHINES]
    longest = max(sum(row[1] for row in many.rows) for many in found)
    yield from [
        "# Five machines that we did not build", "",
        f"Made by `python -m tests.evidence five-machines` on {datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        "Public records, from their authors' files to a diagnosis, by at most five commands each. The longest session "
        f"takes {longest / 60:.1f} minutes.",
        "Each row has a command, its seconds and exit status, and the first line of its answer. The records are no "
        "part of the project.", ""]
    for number, (one, many) in enumerate(zip(MACHINES, found), 1):
        yield from [f"## {number}. {one.title}", "",
                    f"[{one.repository}](https://github.com/{one.repository}), commit `{one.commit[:10]}`, licence: "
                    f"{one.licence}.", "", "```toml", one.rig.rstrip(), "```", ""]
        if one.columns:
            yield from ["The map, by hand:", "", "```toml", one.columns.rstrip(), "```", ""]
        yield from ["| command | s | exit | answer |", "| --- | --- | --- | --- |"]
        for command, seconds, status, said in many.rows:
            yield f"| `{command}` | {seconds:.0f} | {status} | {said.replace('|', '/')} |"
        yield from ["", f"| parameter | legid, 95 % interval | published: {one.source} |", "| --- | --- | --- |"]
        for name, value in one.published.items():
            yield f"| {name} | {interval(many.parameters.get(name))} | {value:.4g} |"
        yield from ["", *(f"- {remark}" for remark in one.remarks), ""]


def interval(found: tuple[float, float, float] | None) -> str:
    return "not determined" if found is None else f"{found[0]:.4g} ({found[1]:.4g} to {found[2]:.4g})"


def longest_session(text: str) -> str:
    """The result for the index: how long, and how many of the published values lie within the interval."""
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| beta")]
    inside = 0
    for _, _, shown, published, _ in rows:
        if "(" in shown:
            low, high = (float(word) for word in shown.split("(")[1].rstrip(") ").split(" to "))
            inside += low <= float(published) <= high
    minutes = text.split("The longest session takes ")[1].split(" minutes")[0]
    return f"{inside} of {len(rows)} published values lie in 95 % intervals; the longest session takes {minutes} min"


EVIDENCE = (
    Evidence("Public records of five machines, from their authors' files to a diagnosis",
             "python -m tests.evidence five-machines", "five-machines.md", 10,
             "at most five commands and ten minutes each", longest_session),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--snapshots", type=Path, required=True, help="a folder with a clone of each repository")
    parser.add_argument("--out", type=Path, required=True)
    words = parser.parse_args(arguments)
    for one in MACHINES:
        if not (words.snapshots / one.repository.split("/")[1]).is_dir():
            raise SystemExit(f"{words.snapshots} lacks {one.repository}: git clone https://github.com/{one.repository}")
    words.out.write_text("\n".join(page(words.snapshots)))
