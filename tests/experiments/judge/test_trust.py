"""The first line: trusted where nothing is hidden, doubted where something is, and the statistics behind it."""

import io
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from estimator import Combination, Finding, FitOptions, Trajectory, fit
from estimator.model import leg2
from estimator.prediction import SHORT_S, PredictedRun, tabulate
from estimator.result import OmittedEffect
from experiments.documents import ComparisonDocument
from experiments.emulation import EFFECTS, NOTHING, record_emulated
from experiments.excite import random_multisine
from experiments.judge import (
    Comparison,
    HorizonError,
    check_fit,
    comparison_trust,
    fit_percent,
    fit_trust,
    validation_trust,
)
from experiments.judge.residuals import autocorrelation, cross_correlation, residuals_of, torque_autocorrelation
from experiments.reports import comparison_text
from experiments.reports.comparison import comparison_sections
from experiments.reports.html import render_page
from tests.support.fits import synthetic_fit, with_slow_gyro
from tests.support.mujoco_leg import Leg, record
from tests.support.paths import DEMO_RIG as RIG
from tests.support.predictions import predicted_run
from tests.support.shell import Shell, document, typed


@pytest.fixture(scope="module")
def folder(module_path: Path) -> Path:
    """Runs of a leg with a spring that nobody told of, and of one without."""
    for name, k in (("none", 0), ("none", 1), ("none", 2), ("joint_stiffness", 0)):
        record_emulated(module_path / f"{name}{k}.mcap", load_rig(RIG), RIG.read_text(),
                        random_multisine(30 + k, 4.0, 0.6), k, hidden=EFFECTS.get(name, NOTHING))
    return module_path


@pytest.fixture(scope="module")
def fits(folder: Path) -> dict[str, str]:
    """Leg -> first line of the fit to its runs but the third, whose model is beside them."""
    said = {}
    for name in ("none", "joint_stiffness"):
        with redirect_stdout(io.StringIO()) as out:
            typed("fit", *sorted(folder.glob(f"{name}[01].mcap")), "--model-out", folder / f"{name}.json")
        said[name] = out.getvalue().splitlines()[0]
    return said


def test_a_hidden_spring_is_suspected_and_a_plain_leg_trusted(fits: dict[str, str]) -> None:
    assert fits["none"].startswith("TRUST the parameters within their intervals. Predicts ")
    assert fits["joint_stiffness"].startswith("DO NOT TRUST the parameters: the torque residual is autocorrelated")


def test_a_leg_with_two_encoders_is_trusted_too() -> None:
    """What it leaves over of the torque is slow by itself: a correlation of 0.8 was called structure."""
    rng = np.random.default_rng(11)
    said = {}
    for stiffness in (0.0, 0.15):
        runs = [record(Leg(coulomb=(0.0, 0.0)), rng, rate_hz=200.0, seconds=8.0, torque=0.01, counts=2**15,
                       spring=(stiffness, 0.3)) for _ in range(2)]
        said[stiffness] = fit(runs, leg2(), FitOptions(sensors="encoder", hold="auto"))
    exact = said[0.0]
    left = residuals_of(exact)["torque 2"]
    assert autocorrelation("", left).largest > 0.5 and torque_autocorrelation(exact, 1, left).largest < 0.1
    assert fit_trust(exact).sentence.startswith("TRUST the parameters")
    told = fit_trust(said[0.15])
    assert told.sentence.startswith("DO NOT TRUST the parameters: ") and len(told.sentence) <= 120
    assert "a passive joint has a torque residual" in told.sentence
    assert any("not taken for noise: joint_stiffness@1 explains" in one for one in said[0.15].assumptions)
    assert "coloured" not in " ".join(exact.assumptions)


def test_commands_say_so_first_and_list_what_the_rigs_disagree_in(
        folder: Path, fits: dict[str, str], tmp_path: Path, shell: Shell) -> None:
    def printed(*words: object) -> list[str]:
        shell(*words)
        return shell.out.splitlines()

    runs = [folder / f"none{k}.mcap" for k in range(3)]
    model, page = folder / "none.json", tmp_path / "p.html"
    assert printed("validate", model, runs[2])[0].startswith("TRUST for simulation over 5 s: fit 9")
    assert printed("validate", model, runs[0])[0].startswith(
        "TRUST WITH CARE for simulation over 5 s: the model was fitted to run none0.mcap")
    other = tmp_path / "rig.toml"
    other.write_text(RIG.read_text().replace("lever_arm_m = 0.2", "lever_arm_m = 0.21"))
    short, *reasons = printed("fit", *runs[:2], "--rig", other)
    assert "the rig file contradicts a run" in short and len(short) <= 120
    assert any(line.startswith("The rig file contradicts a run: none0.mcap") and "lever_arm_m" in line
               for line in reasons[:reasons.index("")])
    first, *_ = printed("validate", model, runs[2], "--rig", other, "--html", page)
    assert "lever_arm_m = 0.2, the rig file in use says 0.21, and 1 more" in first
    text = page.read_text()
    assert "lever_arm_m = 0.2, the rig says 0.21" in text[text.index('class="verdict"'):text.index("<h2>")]
    (command,) = re.findall(r'<pre class="command"[^>]*>(.*?)</pre>', text)
    assert re.sub("<[^>]*>", "", command) == "legid validate none.json none2.mcap --rig rig.toml --html p.html"


def test_what_no_leg_can_be_is_not_to_be_used() -> None:
    sound = synthetic_fit()
    friction = sound.beta.copy()
    friction[6] = -0.5
    for beta in (-sound.beta, friction):
        trust = fit_trust(replace(sound, beta=beta))
        assert trust.sentence == "NOT TO BE USED: no mechanism has these parameters."
        assert ("A mass that is not positive." in trust.reasons) == (beta[0] < 0.0)
        assert "beta7, viscous friction, knee, is negative." in trust.reasons
    assert fit_trust(replace(sound, converged=False)).level == "bad"
    one = (Combination((("beta8", 1.0),)),)
    assert "These runs do not determine beta8." in fit_trust(replace(sound, undetermined=one)).reasons
    every = tuple(Combination(((name, 1.0),)) for name in sound.mechanism.names)
    assert "no parameter" in fit_trust(replace(sound, undetermined=every)).sentence
    assert fit_trust(replace(sound, method="wls")).sentence.startswith("NOT TESTED")


def test_a_noisy_torque_is_no_plain_trust() -> None:
    """A leg whose shunt had a noise of 30 % of its torque: TRUST, and a warning of intervals that are too narrow."""
    sound = synthetic_fit()
    noisy = replace(sound, findings=(Finding("warning", "noise_share", "29 % of the torque's spread counts as noise"),))
    assert fit_trust(sound).sentence.startswith("TRUST the parameters")
    found = fit_trust(noisy)
    assert found.level == "caution" and found.sentence.startswith("TRUST WITH CARE: much of the torque counts as noise")
    assert found.headline.title == found.sentence and list(found.headline.lines) == list(found.reasons)


def test_an_effect_that_the_model_lacks_and_that_moves_a_parameter_is_named() -> None:
    scale, friction = OmittedEffect("gyro_scale", 1e-20, "beta1", 5.81), OmittedEffect("stiction@2", 2e-3, "beta9", 1.2)
    told = fit_trust(replace(synthetic_fit(), omitted=(scale, friction)))
    assert told.sentence == "DO NOT TRUST the parameters: the model seems to lack an effect."
    assert told.reasons[0] == ("The residuals look like gyro_scale, which the model lacks (p 1e-09); it would move "
                               "beta1 by 5.8 half widths of its interval. So would 1 other.")
    assert told.next_step == "Find what the model lacks: legid diagnose RUN... --rig RIG --html diagnosis.html"
    assert "stiction (joint 2)" in fit_trust(replace(synthetic_fit(), omitted=(friction,))).reasons[0]


def test_residuals_of_sensors_and_of_the_passive_joint_count_too() -> None:
    """An encoder off centre left the driven torque white, and parameters 31 standard deviations off."""
    sound = synthetic_fit()
    assert fit_trust(sound).level == "good"
    noisy = replace(sound, noise={**sound.noise, "torque_nm": 0.02, "passive_joint_nm": 0.022})
    assert "residual of a joint without a motor" in fit_trust(noisy).reasons[0]
    wandering = replace(noisy, trajectories=(with_slow_gyro(*sound.trajectories),))
    both = fit_trust(wandering)
    assert both.sentence == ("DO NOT TRUST the parameters: a passive joint has a torque residual, a sensor residual is "
                             "autocorrelated.")
    assert re.match(r"The residual of gyro_radps \(0\.\d+\) is autocorrelated \(limit 0\.2\)\.", both.reasons[1])
    more = replace(wandering, undetermined=(Combination((("beta8", 1.0),)),))
    assert fit_trust(more).sentence.endswith("not all are determined, a passive joint has a torque residual, and 1 "
                                             "more.")


def prediction(error: float, short: float) -> PredictedRun:
    t = np.arange(1001) / 100.0
    measured = {"q1_rad": np.sin(t), "q2_rad": np.sin(t), "gyro_radps": np.sin(t)}
    off = np.std(np.sin(t)) * np.sign(np.sin(20 * t))
    return predicted_run("r", 100.0, measured, {SHORT_S: short * off, np.inf: error * off})


@pytest.mark.parametrize("whole, short, level, words", [
    (0.05, 0.01, "good", "TRUST for simulation over 10 s: fit 95"),
    (0.2, 0.05, "caution", "TRUST for predictions of 1 s"),
    (0.5, 0.2, "caution", "ROUGH"),
    (0.9, 0.5, "bad", "DO NOT TRUST"),
    (np.nan, 0.5, "bad", "DO NOT TRUST")])
def test_validation_says_for_what(whole: float, short: float, level: str, words: str) -> None:
    found = validation_trust(tabulate([prediction(0.01, 0.01), prediction(whole, short)]))
    assert found.level == level and found.sentence.startswith(words)


def test_bands_hold_what_chance_gives_and_show_what_is_there() -> None:
    rng = np.random.default_rng(1)
    u = [np.convolve(rng.standard_normal(4000), np.ones(5) / 5, "same") for _ in range(2)]
    white = [rng.standard_normal(4000) for _ in u]
    outside = np.mean([autocorrelation("e", [rng.standard_normal(2000)]).outside for _ in range(60)])
    assert outside == pytest.approx(0.01, abs=0.01)
    assert cross_correlation("e", white, u).outside < 0.06
    late = [e + 0.5 * np.roll(x, 3) for e, x in zip(white, u)]
    found = cross_correlation("e", late, u)
    assert found.outside > 0.1 and found.lags[np.argmax(found.values)] == 3.0
    coloured = [np.convolve(e, [1.0, 0.8], "same") for e in white]
    assert autocorrelation("e", coloured).values[0] == pytest.approx(0.8 / 1.64, abs=0.03)
    white[0][100:200] = np.nan
    assert autocorrelation("e", white).largest < 0.1


def test_fit_is_matlab_s() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    assert fit_percent(y, y) == 100.0 and fit_percent(y, np.full(4, 2.5)) == pytest.approx(0.0)
    assert fit_percent(y, y + 0.5) == pytest.approx(100 * (1 - 1.0 / np.sqrt(5.0)))


def test_comparison_says_who_is_better_and_by_how_much(folder: Path, fits: dict[str, str], tmp_path: Path,
                                                      shell: Shell) -> None:
    files = [folder / name for name in (*(f"{name}.json" for name in fits), "none2.mcap", "joint_stiffness0.mcap")]
    page = tmp_path / "c.html"
    found = document("compare", *files, "--html", page)
    told = shell.out.splitlines()
    assert "joint_stiffness.json was fitted to joint_stiffness0.mcap" in "".join(told[:3])
    assert found["schema"] == "legid.comparison/1" and {e["column"] for e in found["errors"]} == {
        "q1_rad", "q2_rad", "gyro_radps"}
    beta1 = found["parameters"][0]
    std = np.hypot(beta1["a"]["std"], beta1["b"]["std"])
    assert beta1["z"] == pytest.approx((beta1["b"]["value"] - beta1["a"]["value"]) / std) and abs(beta1["z"]) > 3
    assert "Coulomb friction, knee" in page.read_text() and "error of B" in page.read_text()


def horizon(a: float, b: float, low: float | None = None, high: float = 0.0) -> HorizonError:
    return HorizonError(1.0, "q1_rad", a, b, None if low is None else (low, high))


@pytest.mark.parametrize("errors, words", [
    ([horizon(2.0, 1.0, 0.4, 0.6)] * 3 + [horizon(1.0, 1.0, 0.9, 1.1)], "B IS BETTER (b.json): at 3 of 4"),
    ([horizon(1.0, 2.0, 1.5, 2.5)] * 2, "A IS BETTER (a.json): at 2 of 2"),
    ([horizon(1.0, np.inf)] * 2, "A IS BETTER (a.json): at 2 of 2"),
    ([horizon(1.0, 2.0, 1.5, 2.5), horizon(2.0, 1.0, 0.4, 0.6)], "NEITHER is better throughout"),
    ([horizon(2.0, 1.0)] * 3, "NOT DECIDED: these runs are too short"),
    ([horizon(2.0, 1.0, 0.4, 0.6)] + [horizon(1.0, 1.0, 0.9, 1.1)] * 9, "NEITHER is better: over 10")])
def test_who_is_better(errors: list[HorizonError], words: str) -> None:
    one = tabulate([prediction(0.1, 0.1)])
    found = Comparison(("a.json", "b.json"), (), tuple(errors), one.joined_with(one), ("r",), ())
    assert comparison_trust(found).sentence.startswith(words)
    document = ComparisonDocument.of(found)
    text = comparison_text(document)
    assert "nan" not in text.replace("scan", "") and str(document.trust).startswith(words)
    assert "data-tone" in render_page("t", "s", comparison_sections(document, found.table),
                                      verdict=document.headline)


@pytest.mark.parametrize("repeats", [True, False])
def test_a_disturbance_that_is_a_function_of_the_state_is_structure(repeats: bool) -> None:
    rng, time = np.random.default_rng(5), np.arange(2000) / 200.0
    sound, paths = synthetic_fit(), []
    for k in range(3):
        q = np.column_stack([0.3 * np.sin((2.0 + k) * time), np.sin((3.0 + 0.7 * k) * time + k)])
        e = np.zeros_like(q)
        slow = np.convolve(rng.normal(0.0, 0.005, time.size), np.ones(40) / 6.0, "same")
        e[:, 0] = 0.2 * q[:, 0] ** 3 if repeats else slow
        nothing = np.zeros_like(q)
        paths.append(Trajectory(f"run{k}", time, q, np.gradient(q, time, axis=0), nothing, nothing, nothing, {}, {}, e))
    noise = {**sound.noise, "torque_nm": 0.001, "passive_joint_nm": 0.0005}
    told = [one.text for one in check_fit(replace(sound, trajectories=tuple(paths), noise=noise))
            if one.kind == "repeating_torque"]
    assert bool(told) == repeats and all("at joint 1 is a function of the state" in text for text in told)
