"""The bench of plants of other makes: what is put into a leg's readings, and what its page counts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind import servo, stickslip
from tests.blind.family import FamilyCase, page
from tests.blind.run import diagnose


def answer(root: Path, name: str, effects: list[str], verdict: str, causes: list[str]) -> None:
    truth = {"name": name, "effects": [{"effect": e, "joint": None, "also": []} for e in effects]}
    (root / "cases" / f"{name}.truth.json").write_text(json.dumps(truth))
    (root / "diagnoses" / f"{name}.json").write_text(json.dumps(
        {"verdict": verdict, "causes": [{"effect": c, "joint": None} for c in causes],
         "error": {"before": 3.0, "after": 1.0}, "bench": {"wall_s": 10.0}}))


def test_the_page_counts_every_kind_of_answer(tmp_path: Path) -> None:
    for folder in ("cases", "diagnoses"):
        (tmp_path / folder).mkdir()
    answer(tmp_path, "none-1", [], "none", [])
    answer(tmp_path, "none-2", [], "unexplained", [])
    answer(tmp_path, "gyro_bias-1", ["gyro_bias"], "partial", ["gyro_bias"])
    answer(tmp_path, "gyro_bias-2", ["gyro_bias"], "named", ["gyro_scale"])
    answer(tmp_path, "gyro_bias-3", ["gyro_bias"], "one_of", ["gyro_scale", "gyro_bias"])
    answer(tmp_path, "outside_kink-1", [], "named", ["gyro_scale"])
    text = page("servo", [1, 2, 3], tmp_path)
    for row in ("healthy: false alarm | 1/2", "named exactly | 1/3", "inside the answer | 2/3", "wrong name | 1/3",
                "outside the library: wrong name | 1/1", "| gyro_bias | gyro_bias + ?, gyro_scale, one of"):
        assert row in text
    assert "3.00, 1.00" in text


def test_a_fault_is_in_the_readings_and_nothing_else(tmp_path: Path) -> None:
    """Of one seed: the healthy leg's readings with an offset of the torque that the truth names."""
    readings = {"time_s": np.arange(5) * 0.01, "tau2_nm": np.linspace(-1.0, 1.0, 5), "q2_rad": np.linspace(0.0, 1.0, 5)}
    before = {k: v.copy() for k, v in readings.items()}
    maker, joint = stickslip.MAKERS["torque_offset"]
    maker(1.0)(readings)
    assert joint is None and np.allclose(readings["tau2_nm"] - before["tau2_nm"], 0.06)
    assert np.array_equal(readings["q2_rad"], before["q2_rad"])
    maker, joint = stickslip.MAKERS["encoder_scale"]
    maker(1.0)(readings)
    assert joint == 2 and np.allclose(readings["q2_rad"], 1.04 * before["q2_rad"])


@pytest.mark.slow
def test_a_healthy_leg_of_heavy_friction_raises_no_alarm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times the family's friction, which MuJoCo's solver rounds off over 0.05 rad/s and more; taken for sharp, it
    left the verdict `unexplained` on both legs tried."""
    record = servo.record

    def heavy(leg: Any, plant: Any, dry: float, *more: Any, **named: Any) -> dict[str, np.ndarray]:
        return record(leg, plant, 3.0 * dry, *more, **named)

    monkeypatch.setattr(servo, "record", heavy)
    servo.make_case("none", 61, tmp_path)
    (tmp_path / "diagnoses").mkdir()
    found = diagnose(FamilyCase("none-61"), tmp_path, tmp_path / "diagnoses", share=2)
    assert found["verdict"] == "none", found["sentence"]
    assert any("takes its full level not at once" in text for text in found["warnings"])
