"""`legid tune` chooses by runs that were not fitted, says why, and writes into rig.toml without losing a comment."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq import load_rig, parse_rig
from daq.runs import write_csv
from experiments.session import with_choices
from experiments.workflows import tune_runs
from experiments.workflows.trial import Trial
from experiments.workflows.tune_times import Times, _between, _refined
from tests.support.mujoco_leg import random_leg
from tests.support.prescribed import ARM_RIG, SWING_RIG, arm_run, negated, swing_run, written
from tests.support.shell import Shell, document
from tests.support.timed_leg import Timing, record

LEG_RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[imu]\n'


def timed_runs(folder: Path, seed: int, timing: Timing, rate_hz: float) -> tuple[list[Path], str]:
    """Four runs of a random leg, and a rig file of it with half their rate and a hold that is not theirs."""
    rng = np.random.default_rng(seed)
    leg, runs = random_leg(rng), [folder / f"{name}.csv" for name in "abcd"]
    for file in runs:
        write_csv(record(leg, rng, timing, seconds=6.0, name=file.stem), file)
    return runs, (f"{LEG_RIG}lever_arm_m = {leg.lever}\n[noise]\nencoder_rad = 1.1e-4\n[filter]\ncutoff_hz = 5.0\n"
                  f'[sampling]\nrate_hz = {rate_hz}\nhold = "average"\n')


def test_what_is_chosen_is_told_and_written(here: Path, shell: Shell) -> None:
    runs = written([arm_run(k, seconds=5.0, offset=(0.15, 0.0)) for k in range(4)], here)
    rig = here / "rig.toml"
    text = f"# our arm\n{ARM_RIG}[noise]\nencoder_rad = 1e-4   # by its data sheet\n[filter]\ncutoff_hz = 8.0\n"
    rig.write_text(text)
    shell("tune", *runs[:2], "--rig rig.toml")
    assert "[terms] torque_offset" in shell.out and rig.read_text() == text  # not asked to write
    found = document("tune", *runs, "--rig rig.toml --write")
    printed = shell.out
    assert "[terms] torque_offset" in printed and "a constant in the measured torque" in printed
    assert "on held-out runs" in printed
    assert found["error_after"][0] < 0.7 * found["error_before"][0]
    tried = {t["entry"] for t in found["tried"]}
    assert "[sampling] rate_hz" in tried and "[sampling] hold" in tried
    assert "[noise] encoder_rad" not in tried and "[filter] cutoff_hz" not in tried  # stated: kept
    written_text = rig.read_text()
    assert written_text.startswith("# our arm\n") and "# by its data sheet" in written_text
    assert load_rig(rig).terms.torque_offset == (1,)
    shell("fit", *runs, "--rig rig.toml")
    assert "chosen, where rig.toml is silent: torque_offset" not in shell.out


def test_no_entry_changes_where_no_fit_predicts(here: Path, shell: Shell) -> None:
    runs = written([negated(swing_run(0.02, 0.05), "tau1_nm")], here)
    rig = here / "rig.toml"
    text = f"{SWING_RIG}[sampling]\nrate_hz = 50.0\n"
    rig.write_text(text)
    found = document("tune", *runs, "--rig rig.toml --write", status=1)
    assert rig.read_text() == text
    assert shell.out.startswith("nothing is chosen: ")
    assert {t["error"] for t in found["tried"]} == {"no prediction"} and found["chosen"] == []


def test_a_parameter_may_be_given(here: Path, shell: Shell) -> None:
    runs = written([swing_run(0.02, 0.05)], here)
    rig = here / "rig.toml"
    rig.write_text(f"{SWING_RIG}[filter]\ncutoff_hz = 5.0\n")
    right, wrong = (document("tune", *runs, "--rig rig.toml --fix", given)["error_before"][0]
                    for given in ("beta4=0.05", "beta4=0.5"))  # Coulomb friction as it is, and ten times that
    assert wrong > 2.0 * right
    assert "joint1 has no parameter beta5" in shell.fails("tune", *runs, "--rig rig.toml --fix beta5=1")


def test_rate_hold_and_delay_are_found_together(here: Path, shell: Shell) -> None:
    """A controller that holds its torque from 3 ms after its stamp on; the rig file has half the rate, another hold."""
    runs, text = timed_runs(here, 1, Timing(200.0, delay_s=0.003), 100.0)
    rig = here / "rig.toml"
    rig.write_text(text)
    found = document("tune", *runs, "--rig rig.toml --write")
    assert "rate, hold and delay were varied together: rate 200 Hz (instead of 100 Hz: error" in shell.out
    tuned = load_rig(rig)
    assert (tuned.sampling.rate_hz, tuned.sampling.hold) == (200.0, "zero")
    assert tuned.timing.torque_delay_s is not None
    assert tuned.timing.torque_delay_s[0] == pytest.approx(0.003, abs=2.5e-4)
    gains = {one["what"]: one["gain"] for one in found["times"]}
    assert set(gains) == {"rate", "hold", "delay"} and min(gains.values()) > 0.3
    assert np.all(np.array(found["error_after"]) < 0.5 * np.array(found["error_before"]))


@pytest.mark.parametrize("seed, timing, rate_hz, grids, sampling", [
    (2, Timing(200.0, 2), 50.0, {25.0, 100.0}, (100.0, "auto", 0.005)),
    (3, Timing(500.0, 2), 125.0, {31.25, 62.5, 250.0}, (250.0, "auto", 0.002))], ids=["hold", "rate"])
def test_a_hold_without_a_delay_is_tried_on_each_grid_of_whole_parts_of_the_record_s_rate(
        seed: int, timing: Timing, rate_hz: float, grids: set[float], sampling: tuple[float, str, float],
        tmp_path: Path) -> None:
    """A controller of 200 Hz logged at 100: with the rig file's hold alone both grids predict alike badly.

    At 200 of 250 samples a second each reading lies between two, and the record's own grid seemed the worse one.
    """
    runs, text = timed_runs(tmp_path, seed, timing, rate_hz)
    rig = parse_rig(text)
    found = tune_runs(runs, rig)
    assert {float(value) for entry, value, _ in found.tried if entry == "[sampling] rate_hz"} == grids
    chosen = with_choices(rig, found.choices)
    assert (chosen.sampling.rate_hz, chosen.sampling.hold, chosen.timing.control_period_s) == pytest.approx(sampling)
    assert chosen.timing.torque_delay_s is None


def test_a_hold_that_no_rig_file_states_is_a_smooth_torque_and_a_delay() -> None:
    run = SimpleNamespace(rate_hz=50.0)
    bench: Any = SimpleNamespace(between=lambda rig: ("past/2", 0.003), runs=lambda rig: [run])
    assert _between(bench, parse_rig(LEG_RIG)) == ("smooth", pytest.approx(-0.002))


@pytest.mark.parametrize("depth, wanted", [(4.0, 0.0122), (0.1, 0.0150)])
def test_a_delay_changes_where_another_predicts_better(depth: float, wanted: float) -> None:
    """The likelihood's stays where the others gain too little."""
    def attempt(times: Times) -> Trial:
        off = 100.0 * (times.delay_s - 0.0122)
        return Trial(depth * off**2, np.zeros(2), {}, None)

    found = _refined(Times(100.0, "smooth", 0.0150), attempt)
    assert found[:2] == (100.0, "smooth") and found.delay_s == pytest.approx(wanted, abs=4e-4)
    assert _refined(Times(100.0, "smooth", 0.0), attempt).delay_s == 0.0
