"""Servos through a fit: one that says what it was commanded and not what it gave, and one that is switched off."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import legid
from daq import Dataset, InputError, parse_rig
from evidence.servos import Drawn, Hidden, draw, record
from experiments.session import driven, load_runs
from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.runs import with_columns, without
from tests.support.servo_joint import servo_run
from tests.support.servo_leg import ServoFaults, follow
from tests.support.shell import Shell, document, values

GAIN, DAMPING, LIMIT = 6.0, 0.15, 0.3
RIG = '[tolerance]\nnone = true\n[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\n'


@pytest.fixture(scope="module")
def leg() -> Leg:
    return replace(random_leg(51), viscous=(0.01, 0.02), coulomb=(0.01, 0.03))


def fitted(runs: list[Dataset], servo: str, fixed: Leg | None = None) -> dict[str, Any]:
    """The document of a fit under this [servo], with beta5 of a leg given."""
    given = {} if fixed is None else {"beta5": float(fixed.beta()[4])}
    return legid.fit(runs, parse_rig(RIG + servo), fixed=given).document


def followed(leg: Leg, seed: int, count: int = 3, **law: Any) -> list[Dataset]:
    """Runs of its knee by a law with GAIN."""
    rng = np.random.default_rng(seed)
    return [follow(leg, rng, gain=GAIN, name=f"run{k}", **law) for k in range(count)]


def test_a_law_with_damping_and_a_limit_stands_for_the_torque(leg: Leg) -> None:
    runs = followed(leg, 52, damping=DAMPING, limit=LIMIT)
    error = runs[0]["q2_cmd_rad"] - runs[0]["q2_rad"]
    lost = np.abs(GAIN * error - DAMPING * np.gradient(runs[0]["q2_rad"], 0.01)) > LIMIT
    assert 0.05 < np.mean(lost) < 0.6  # the limit is met
    told = fitted(runs, f"gain = {GAIN}\ndamping = {DAMPING}\nlimit = {LIMIT}\n")
    assert values(told)[:5] == pytest.approx(leg.beta()[:5], rel=0.03)
    assert values(told)[[6, 8]] == pytest.approx(leg.beta()[[6, 8]], rel=0.2)
    assert told["servo_gain"] is None


def test_a_gain_is_found_by_one_parameter_that_is_given(here: Path, leg: Leg) -> None:
    """As typed and in Python."""
    runs, rig = followed(leg, 53, 2), here / "rig.toml"
    rig.write_text(RIG)
    paths = [table_of(run, here / f"{run.name}.csv") for run in runs]
    told = document("fit", *paths, f"--rig rig.toml --fix beta5={leg.beta()[4]}")
    low, high = told["servo_gain"]["ci95"]
    assert told["servo_gain"]["value"] == pytest.approx(GAIN, rel=0.03) and high - low < 0.2 * GAIN
    assert values(told)[:5] == pytest.approx(leg.beta()[:5], rel=0.03)
    made = legid.fit(legid.load(paths, rig), rig, fixed={"beta5": leg.beta()[4]})  # a number of numpy's is one, too
    assert made.document["servo_gain"] == told["servo_gain"]
    fixed, = (p for p in told["parameters"] if p["fixed"])
    assert (fixed["name"], fixed["value"], fixed["std"]) == ("beta5", pytest.approx(leg.beta()[4]), 0.0)
    same = fitted(runs, f"gain = {GAIN}\n")
    assert values(same) == pytest.approx(values(told) * GAIN / told["servo_gain"]["value"], rel=1e-3)


@pytest.mark.parametrize("servo, fix", [(f"gain = {GAIN}\ndamping = {DAMPING}\n", False), ("", True)])
def test_a_delay_that_nobody_states_is_found_and_taken_off(leg: Leg, servo: str, fix: bool) -> None:
    runs = followed(leg, 55, damping=DAMPING, faults=ServoFaults(delay_s=0.012))
    told = fitted(runs, servo, leg if fix else None)
    (chosen,) = (c for c in told["chosen"] if c["key"] == "delay_s")
    assert chosen["table"] == "servo" and chosen["value"] == pytest.approx(0.0122, abs=5e-4)
    assert values(told)[:5] == pytest.approx(leg.beta()[:5], rel=0.01)
    assert any("act 12" in text or "act 11.9" in text for text in told["assumptions"])


def loop_of(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["key"]: one for one in told["loop"]}


@pytest.mark.parametrize("servo, fix", [(f"gain = {GAIN}\n", False), ("", True)])
def test_limit_damping_integral_and_delay_are_found_where_nobody_states_them(leg: Leg, servo: str, fix: bool
                                                                            ) -> None:
    runs = followed(leg, 55, damping=DAMPING, limit=LIMIT, faults=ServoFaults(delay_s=0.008, integral=2.0))
    told = fitted(runs, servo, leg if fix else None)
    found = loop_of(told)
    for key, truth, close in (("limit", LIMIT, 0.01), ("damping", DAMPING, 0.02), ("integral", 2.0, 0.01)):
        low, high = found[key]["ci95"]
        assert found[key]["value"] == pytest.approx(truth, rel=close) and 0.0 < high - low < 4.0 * close * truth
        assert any(c["key"] == key and c["table"] == "servo" for c in told["chosen"])
    assert found["delay_s"]["value"] == pytest.approx(0.008, abs=8e-4)
    assert values(told)[:5] == pytest.approx(leg.beta()[:5], rel=0.02)
    assert values(told)[6] == pytest.approx(leg.beta()[6], abs=0.003)  # without the loop's damping


def loop_found(seed: int, **fault: float) -> tuple[Drawn, dict[str, dict[str, Any]]]:
    """A leg of this seed under this fault, and what a fit finds of its loop."""
    drawn = draw(seed)
    runs = record(drawn, seed, Hidden("none", lambda s: ServoFaults(**fault)), drawn.delay_s)
    rig = parse_rig(f"{RIG}gain = {drawn.gain}\nrate_hz = {drawn.loop_hz}\n")
    return drawn, loop_of(legid.fit(runs, rig).document)


def test_a_limit_that_few_runs_meet_is_found_and_is_as_open_as_the_damping() -> None:
    """Two of eight runs meet it. Without the loop's damping it is larger: its interval says so, and the delay is right.
    """
    drawn, found = loop_found(9300, limit=1.115)
    assert found["delay_s"]["value"] == pytest.approx(drawn.late_s, abs=3e-4)  # 14.3 for 19 ms without a limit
    low, high = found["limit"]["ci95"]
    assert found["limit"]["found"] and low < 1.115 < high


def test_a_limit_is_found_where_the_loop_damps_much() -> None:
    """The friction of the joint takes the loop's damping up: a share of the torque with it would always fall."""
    drawn, found = loop_found(9606, limit=0.6222)
    for key, true, close in (("limit", 0.6222, 0.01), ("damping", drawn.damping, 0.02),
                             ("delay_s", drawn.late_s, 0.01)):
        assert found[key]["found"] and found[key]["value"] == pytest.approx(true, rel=close)


def test_what_an_encoder_misreads_is_no_noise_of_the_torque_that_the_law_makes() -> None:
    """Of 12 bits, the gain makes 4 mN m, and the loop's damping 8: a delay was 2 ms too short."""
    drawn = draw(9400)
    rig = parse_rig(f"{RIG}gain = {drawn.gain}\ndamping = {drawn.damping}\nrate_hz = {drawn.loop_hz}\n")
    told = legid.fit(record(drawn, 9400, delay_s=drawn.delay_s), rig).document
    assert told["noise"]["torque_nm"] < drawn.gain * told["noise"]["encoder_rad"]
    low, high = loop_of(told)["delay_s"]["ci95"]
    assert low < drawn.late_s < high < low + 2e-4


@pytest.mark.slow
def test_a_wrong_encoder_is_tried_in_place_of_a_disturbance() -> None:
    """Behind a loop it has a shape; the integral that nobody states is what the disturbance was."""
    _, found = loop_found(19418, integral=3.275)
    assert found["integral"]["found"] and found["integral"]["value"] == pytest.approx(3.275, rel=0.02)


def test_a_stiff_servo_s_gain_is_not_called_missing() -> None:
    """A gain scales all parameters. Its score only says that less of everything leaves less: a size of -2."""
    runs = [follow(draw(47).leg, 47_000 + k, gain=12.0, damping=0.07, seconds=8.0, faults=ServoFaults(delay_s=0.015),
                   name=f"r{k}") for k in range(4)]
    found = legid.fit(runs, parse_rig('[mechanism]\nmodel = "leg2"\nactuated = [2]\n[servo]\ngain = 12.0\n'
                                      "damping = 0.07\n"))
    assert not found.estimate.omitted and found.trust.level == "good"


def test_what_the_runs_do_not_show_of_a_loop_is_said(leg: Leg) -> None:
    runs = followed(leg, 57, damping=DAMPING)
    told = fitted(runs, f"gain = {GAIN}\n")
    found, said = loop_of(told), " ".join(told["assumptions"])
    low, high = found["integral"]["ci95"]
    assert not found["integral"]["found"] and low < 0.0 < high < 0.2
    assert set(found) <= {"delay_s", "integral"}
    assert not [c for c in told["chosen"] if c["key"] in ("limit", "integral")]
    assert "beta7 has the damping of joint 2's loop in it" in said and "servo.damping states it" in said
    assert "meet no limit; servo.limit states it" in said and "servo.integral states it" in said
    assert values(told)[6] == pytest.approx(leg.beta()[6] + DAMPING, rel=0.05)
    stated = fitted(runs, f"gain = {GAIN}\ndamping = {DAMPING}\nintegral = 0.0\nlimit = 20.0\n")
    assert not any("servo." in text and "states it" in text for text in stated["assumptions"])


def test_filters_of_rate_and_command_are_taken_into_account(leg: Leg) -> None:
    runs = followed(leg, 58, damping=0.4, faults=ServoFaults(velocity_filter_s=0.01, command_filter_s=0.02))
    law = f"gain = {GAIN}\ndamping = 0.4\nintegral = 0.0\nlimit = 20.0\ndelay_s = 0.0\n"
    known = fitted(runs, f"{law}velocity_filter_s = 0.01\ncommand_filter_s = 0.02\n")
    assert values(known)[:5] == pytest.approx(leg.beta()[:5], rel=0.02)


def test_a_filter_of_the_rate_that_is_uncertain_widens_the_inertia() -> None:
    runs = [servo_run(f"run{k}", seed=k) for k in (1, 2, 3)]
    law = ('[mechanism]\nmodel = "joint1"\nactuated = [1]\n[tolerance]\n{0}\n[servo]\ngain = 4.0\ndamping = 0.1\n'
           'integral = 0.0\nlimit = 20.0\ndelay_s = 0.0\n')
    found = [legid.fit(runs, parse_rig(law.format(stated))).document["parameters"][0]["std"]
             for stated in ("none = true", "none = true\nvelocity_filter = 0.01")]
    assert np.sqrt(found[1] ** 2 - found[0] ** 2) == pytest.approx(0.1 * 0.01, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed, faults, effect, size, where", [
    (56, ServoFaults(delay_s=0.02), "command_delay", 0.02, ""),
    (67, ServoFaults(log_scale=0.04), "encoder_scale", 0.04, "the loop hears the true angle"),
    (67, ServoFaults(encoder_scale=-0.2), "encoder_scale", -0.2, "the loop hears it")],
    ids=["late command", "in the log", "at the encoder"])
def test_a_diagnosis_under_the_command_names_the_cause_and_its_place(leg: Leg, seed: int, faults: ServoFaults,
                                                                     effect: str, size: float, where: str) -> None:
    runs = [follow(leg, np.random.default_rng([seed, k]), gain=GAIN, damping=DAMPING, seconds=8.0,
                   high=(2.2, 1.0, 1.6)[k % 3], faults=faults, name=f"r{k}") for k in range(6)]
    found = legid.diagnose(runs, parse_rig(f"{RIG}gain = {GAIN}\ndamping = {DAMPING}\n"), workers=1)
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.joint) == ("named", effect, 2)
    assert cause.size[0].value == pytest.approx(size, rel=0.1)
    assert where in found.text()


def test_what_is_lacking_is_named(here: Path, leg: Leg, shell: Shell) -> None:
    run = follow(leg, 54, gain=GAIN, seconds=3.0)
    (here / "rig.toml").write_text(RIG)
    said = shell.fails("fit", table_of(run, here / "run.csv"), "--rig rig.toml", status=1)
    assert "give it as gain under [servo], or give one parameter" in said
    bare = replace(run, columns={name: run[name] for name in ("q1_rad", "q2_rad")})
    with pytest.raises(InputError, match="q2_cmd_rad is missing; add the angle that the servo was commanded"):
        load_runs([table_of(bare, here / "bare.csv")], parse_rig(RIG))
    for servo, what in (("damping = 0.1\n", "says nothing without servo.gain"),
                        ("gain = [1.0, 2.0]\n", r"servo\.gain has 2 numbers"), ("gain = -1.0\n", "gain")):
        with pytest.raises(InputError, match=what):
            parse_rig(RIG + servo)


def test_a_measured_torque_goes_before_the_law_and_volts_are_duty_of_the_law() -> None:
    time = np.arange(60) / 100.0
    columns = {"q1_rad": 0.1 * np.sin(time), "q1_cmd_rad": np.linspace(0.0, 3.0, 60), "volts": np.full(60, 7.4)}
    rig = parse_rig('[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n[servo]\ngain = 0.5\n')
    found = driven(Dataset("run", 100.0, time, columns), rig)
    assert found["voltage1_v"] == pytest.approx(7.4 * np.clip(0.5 * (columns["q1_cmd_rad"] - columns["q1_rad"]), -1, 1))
    measured = driven(Dataset("run", 100.0, time, {**columns, "duty": np.full(60, 0.25)}), rig)
    assert measured["voltage1_v"] == pytest.approx(np.full(60, 7.4 * 0.25))


VOLT_RIG = '[mechanism]\nmodel = "joint1"\nactuated = [1]\ninput = "voltage"\n[tolerance]\nnone = true\n'
INERTIA, MOMENT, VISCOUS, COULOMB, K, R, VOLTS = 0.005, 0.05, 0.002, 0.01, 0.3, 3.0, 7.4
TRUE = R / K * np.array([INERTIA, MOMENT, VISCOUS + K**2 / R, COULOMB])
"""Parameters in volts, back-EMF in the viscous one"""


def recorded(seed: int, seconds: float = 8.0, step: float = 1e-3) -> Dataset:
    """A pendulum on a motor that is off for two seconds from 3 s on, where the register of its duty is 0."""
    rng = np.random.default_rng(seed)
    phases, count = rng.uniform(0.0, 6.0, 3), int(seconds / step)
    q, v, rows = 0.0, 0.0, []
    for k in range(count):
        t = k * step
        on = not 3.0 <= t < 5.0
        duty = 0.25 * sum(math.sin(2.0 * math.pi * f * t + p) for f, p in zip((0.4, 0.9, 1.7), phases)) if on else 0.0
        if k % 10 == 0:
            rows.append((t, q, duty, VOLTS, float(on)))
        torque = K / R * (duty * VOLTS - K * v) if on else 0.0
        v += step / INERTIA * (torque - MOMENT * 9.81 * math.sin(q) - VISCOUS * v - COULOMB * math.tanh(v / 0.01))
        q += step * v
    time, angle, *others = np.array(rows).T
    angle = angle + rng.normal(0.0, 4e-4, angle.size)
    columns = dict(zip(("q1_rad", "duty", "volts", "torque_enable"), (angle, *others)))
    return Dataset(f"run{seed}", 1.0 / (10 * step), time, columns)


def test_an_open_motor_does_not_brake() -> None:
    runs = [recorded(seed) for seed in (1, 2, 3)]
    rig = parse_rig(VOLT_RIG)
    known, unknown = legid.fit(runs, rig), legid.fit([without(run, "torque_enable") for run in runs], rig)
    assert known.beta == pytest.approx(TRUE, rel=0.01)
    assert unknown.beta[3] < 0.5 * TRUE[3]  # an open motor taken for one at 0 V swings on without friction
    assert unknown.document["noise"]["torque_nm"] > 10.0 * known.document["noise"]["torque_nm"]
    assert any("run1 has its motor off for 2 s by torque_enable" in text for text in known.document["warnings"])
    assert any("run1 has duty 0 for 2 s from 3 s on while the joint moves" in text
               for text in unknown.document["warnings"])


def test_a_motor_that_is_off_has_no_voltage_and_a_command_does_nothing() -> None:
    run = recorded(1)
    run = with_columns(run, q1_cmd_rad=np.sin(run.time_s))
    off = run["torque_enable"] < 0.5
    found = driven(run, parse_rig(VOLT_RIG))
    for name in ("duty", "voltage1_v", "q1_cmd_rad"):
        assert np.array_equal(np.isnan(found[name]), off)
    assert len(driven(found, parse_rig(VOLT_RIG)).flags) == 1  # said once
    law = driven(without(run, "duty", "volts"), parse_rig(
        '[mechanism]\nmodel = "joint1"\nactuated = [1]\n[servo]\ngain = 4.0\n'))
    assert np.array_equal(np.isnan(law["tau1_nm"]), off)


@pytest.mark.parametrize("still", [True, False])
def test_duty_zero_is_asked_about_only_where_the_joint_moves_for_a_while(still: bool) -> None:
    time = np.arange(400) / 100.0
    duty = np.where((time > 1.0) & (time < (3.0 if still else 1.1)), 0.0, 0.2)
    angle = np.where(duty == 0.0, 0.0, np.sin(time)) if still else np.sin(5.0 * time)
    run = Dataset("run", 100.0, time, {"q1_rad": angle, "duty": duty, "volts": np.full(400, 7.4)})
    assert driven(run, parse_rig(VOLT_RIG)).flags == ()
