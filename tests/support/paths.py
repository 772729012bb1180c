"""Places in the checkout and beside it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEMO_RIG = ROOT / "experiments/workflows/demo_rig.toml"
REAL = ROOT.parent / "shared/realdata"
"""Real records with published answers; no part of the project."""
CASES = ROOT.parent / "shared/cases"
"""Files and records that were answered wrongly once; no part of the project."""
needs_records = pytest.mark.skipif(not REAL.is_dir(), reason="the shared real records are not next to the checkout")
FIXTURES = ROOT / "tests/fixtures"
"""Recordings of an emulated leg, made by `make fixtures`."""
