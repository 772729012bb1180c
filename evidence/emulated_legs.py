"""Emulated legs with random parameters, the rig file and labels of the studies that record them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from daq import Rig, load_rig
from experiments.emulation import LegBody
from tests.support.paths import DEMO_RIG

RATE_HZ = 100.0
SPREAD = 0.15
"""Standard deviation of the logarithm of the legs' parameters about the emulated leg's."""


def leg_of(seed: int, number: int) -> LegBody:
    """Leg `number` of the study with this seed."""
    rng, plain = np.random.default_rng([seed, number]), LegBody()
    factor = np.exp(SPREAD * rng.standard_normal(8)).tolist()
    return replace(plain, m1=plain.m1 * factor[0], i1=plain.i1 * factor[1], m2=plain.m2 * factor[2],
                   i2=plain.i2 * factor[3], viscous=(plain.viscous[0] * factor[4], plain.viscous[1] * factor[5]),
                   coulomb=(plain.coulomb[0] * factor[6], plain.coulomb[1] * factor[7]))


def rig_in(folder: Path) -> tuple[Rig, str]:
    """The demo's rig at RATE_HZ and its text, which is written to rig.toml in `folder`."""
    text = DEMO_RIG.read_text(encoding="utf-8").replace("rate_hz = 250.0", f"rate_hz = {RATE_HZ}")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    return load_rig(folder / "rig.toml"), text


def label(effect: str, joint: int | None) -> str:
    """`effect@joint`."""
    return effect if joint is None else f"{effect}@{joint}"
