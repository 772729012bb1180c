"""Does a known weight find a wrong torque constant, and does its interval hold? On emulated legs, through all bytes.

Each leg is drawn anew with a gain of its torque that its rig file does not know. It is recorded twice under a staircase
of torques, bare and with a weight whose arm was measured with an error, and `legid calibrate shunt --weight` is asked.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq.rig import parse_rig
from estimator import FitError
from estimator.calibration import Weight
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.calibrate import calibrate_torque_constant
from experiments.emulation import LegBody, record_emulated
from experiments.emulation.hidden_effects import Hidden
from experiments.excite import staircase
from studies import machine
from tests.support.paths import DEMO_RIG, ROOT
from tests.support.runs import load_run

LEVELS, RAMP_S, HOLD_S, PEAK = 3, 2.0, 1.2, 0.75
"""The peak as a share of the bare shank's largest moment."""
MASS_KG, ARM_M, MASS_HALF_KG, ARM_HALF_M = 0.5, 0.25, 0.0005, 0.001
PAGE = ROOT / "docs/evidence/torque-gain.md"
GAIN = (0.88, 1.12)
COULOMB_NM, STRIBECK_NM = (0.01, 0.06), (0.0, 0.03)


def leg(rng: np.random.Generator) -> LegBody:
    """Masses within a fifth of the demo's leg, friction of its own, every other leg with more of it at rest."""
    body = LegBody()
    masses = {name: getattr(body, name) * float(rng.uniform(0.8, 1.2)) for name in ("m1", "m2", "i1", "i2", "c2")}
    knee, pivot = rng.uniform(*COULOMB_NM, 2).tolist()
    stribeck = float(rng.uniform(*STRIBECK_NM)) * int(rng.integers(2))
    return replace(body, **masses, coulomb=(0.5 * pivot, knee), stribeck=(0.0, stribeck))


@kept
def measured(seed: int) -> tuple[float, float, float]:
    """(true gain, gain found, half of its 95 % interval). Raises `FitError`."""
    rng = np.random.default_rng(seed)
    text = DEMO_RIG.read_text(encoding="utf-8").replace("rate_hz = 1000.0", "rate_hz = 200.0")
    rig, body, gain = parse_rig(text), leg(rng), float(rng.uniform(*GAIN))
    arm = ARM_M + 0.5 * ARM_HALF_M * float(rng.standard_normal())
    plan = staircase(PEAK * body.m2 * body.c2 * body.gravity / gain, LEVELS, RAMP_S, HOLD_S)
    hidden = Hidden("torque_gain", None, "", torque_gain=gain)
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        for k, carried in enumerate((body, body.carrying(MASS_KG, arm))):
            path = Path(folder) / f"{seed}-{k}.mcap"
            record_emulated(path, rig, text, plan, 2 * seed + k, carried, hidden)
            runs.append(load_run(path, rig))
    old = rig.calibration.torque_constant_nm_per_a
    weight = Weight(MASS_KG, ARM_M, MASS_HALF_KG, ARM_HALF_M)
    values = calibrate_torque_constant(runs[:1], runs[1:], rig, weight).values["calibration"]
    found, half = (float(str(values[f"torque_constant{part}_nm_per_a"])) / old for part in ("", "_half"))
    return gain, found, half


def page(seeds: range) -> str:
    """The page."""
    rows, inside, refused = [], [], 0
    for seed in seeds:
        try:
            gain, found, half = measured(seed)
        except FitError as error:
            refused += 1
            rows.append(f"| {seed} | | refused: {error} | | |")
            continue
        inside.append(abs(found - gain) < half)
        rows.append(f"| {seed} | {gain:.4f} | {found:.4f} | {half:.4f} | {(found - gain) / half:+.2f} |")
        print(rows[-1], flush=True)
    halves = [float(row.split("|")[4]) for row in rows if row.split("|")[4].strip()]
    errors = [float(row.split("|")[5]) for row in rows if row.split("|")[5].strip()]
    return "\n".join([
        "# A wrong torque constant, by a known weight", "",
        f"Made by `python -m evidence torque-gain`, seeds {seeds.start} to {seeds.stop - 1}, "
        f"{datetime.now(UTC):%Y-%m-%d}, {machine()}.", "",
        f"Emulated legs, recorded through all bytes. Masses are within 20 % of the demo's. Dry friction of the knee is "
        f"{COULOMB_NM[0]:g} to {COULOMB_NM[1]:g} N m, on half of the legs up to {STRIBECK_NM[1]:g} N m more at rest. "
        f"Each drive makes {GAIN[0]:g} to {GAIN[1]:g} times the torque that its rig file says. Each leg is held at "
        f"{4 * LEVELS} torques, bare and with {MASS_KG:g} kg at {ARM_M:g} m. The arm has a declared standard error "
        f"of {0.5e3 * ARM_HALF_M:g} mm.", "",
        f"**Intervals that hold: {sum(inside)} of {len(inside)}**, {refused} refused. Half width of the 95 % interval: "
        f"{np.median(halves):.4f} in the median, {max(halves):.4f} at most. Error over half width: mean "
        f"{np.mean(errors):+.2f}, rms {np.sqrt(np.mean(np.square(errors))):.2f} (0.51: the interval is exact).", "",
        "| seed | true gain | found | half | error / half |", "| ---: | ---: | ---: | ---: | ---: |", *rows, ""])


EVIDENCE = (
    Evidence("A wrong torque constant found by a known weight: does the interval hold?",
             "python -m evidence torque-gain", "torque-gain.md", 10, "95 % of the intervals hold",
             (r"Intervals that hold: (\d+ of \d+)", r"[\d.]+ in the median")),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--legs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=9004)
    parser.add_argument("--out", type=Path, default=PAGE)
    given = parser.parse_args(arguments)
    given.out.write_text(page(range(given.seed, given.seed + given.legs)), encoding="utf-8")
