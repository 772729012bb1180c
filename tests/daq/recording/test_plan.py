"""Plans: read, written, refused."""

from pathlib import Path

import numpy as np
import pytest

from daq.errors import InputError
from daq.recording.plan import Plan, read_plan, write_plan


def test_a_plan_reads_back(tmp_path: Path) -> None:
    plan = Plan(np.arange(5) * 0.02, np.array([0.0, 0.5, -1.25, 1 / 3, 0.0]))
    write_plan(plan, tmp_path / "p.csv")
    text = (tmp_path / "p.csv").read_text().splitlines()
    assert text[:3] == ["time_s,tau2_cmd_nm", "0.000000000,0", "0.020000000,0.5"]
    again = read_plan(tmp_path / "p.csv")
    np.testing.assert_allclose(again.torque_nm, plan.torque_nm, rtol=1e-9)
    assert again.duration_s == pytest.approx(0.1)
    assert again.peak_nm == 1.25


def test_commands_are_due_from_the_first_on() -> None:
    plan = Plan(np.array([3.0, 3.01, 3.5]), np.zeros(3))
    assert plan.offset_ns == [0, 10_000_000, 500_000_000]


@pytest.mark.parametrize(("text", "said"), [
    ("time_s,torque\n0,1\n1,2\n", "column tau2_cmd_nm is missing"),
    ("tau2_cmd_nm\n1\n2\n", "column time_s is missing"),
    ("time_s,tau2_cmd_nm\n0,1\n1,much\n", "line 3, column tau2_cmd_nm: 'much' is not a number"),
    ("time_s,tau2_cmd_nm\n0,1\n0,2\n", "line 3, column time_s: time repeats"),
    ("time_s,tau2_cmd_nm\n0,1\n", "holds 1 samples, at least 2"),
])
def test_a_faulty_plan_is_refused_like_a_run(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_plan(tmp_path / "p.csv")
    assert said in str(caught.value)


@pytest.mark.parametrize(("time_s", "torque"), [([0.0], [1.0]), ([0, 1], [1.0]), ([1, 0], [1, 1]),
                                                ([0, 1], [1, np.nan]), ([0, np.inf], [1, 1])])
def test_a_plan_made_in_code_is_checked_too(time_s: list[float], torque: list[float]) -> None:
    with pytest.raises(ValueError):
        Plan(np.array(time_s, float), np.array(torque, float))
