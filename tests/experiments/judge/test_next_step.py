"""Every verdict has a next step with its place and a command that exists; a huge share of a budget is no bar."""

import re
from dataclasses import replace

import pytest

from estimator import VERDICTS, Verdict
from estimator.change import Change
from estimator.diagnosis import Remainder
from estimator.effects.generic_terms import READINGS, TORQUE_LAWS
from experiments.documents import DiagnosisDocument
from experiments.judge import Files, next_of_change, next_step, with_names
from experiments.judge.next_steps import RECORD, SENSORS, variable_of
from experiments.reports import diagnosis_text
from legid.cli.main import build_parser
from tests.support.diagnoses import synthetic

FILES = Files(("a.csv", "my run.csv"), "leg.toml", "ext.json", "d.json")


def options_of(command: str) -> set[str]:
    """Options that the parser of `command` knows."""
    parser = build_parser()
    (subparsers,) = (a for a in parser._actions if hasattr(a, "choices") and a.choices and "fit" in a.choices)
    choices = subparsers.choices
    assert isinstance(choices, dict)
    return {option for action in choices[command]._actions for option in action.option_strings}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_one_with_a_real_command_and_names_the_files_that_were_given(verdict: Verdict) -> None:
    found = replace(synthetic(), verdict=verdict)
    step = next_step(found)
    assert "\n" not in step and step in diagnosis_text(DiagnosisDocument.of(found))
    assert DiagnosisDocument.of(found).document["next_step"] == step
    commands = re.findall(r"legid ([a-z]+)(.*?)(?=, then|$)", step)
    assert commands
    for command, words in commands:
        assert set(re.findall(r"--[a-z-]+", words)) <= options_of(command), step
    document, named = DiagnosisDocument.of(found), with_names(step, FILES)
    assert named in diagnosis_text(document, FILES) and with_names(document.headline.action, FILES) == named
    assert "RIG" not in named and "MODEL.json" not in named and not re.search(r"(?<!NEW_)RUN", named)


def test_causes_of_a_change_are_told_apart_as_those_of_a_diagnosis() -> None:
    found = replace(synthetic(), verdict="one_of")
    assert next_of_change(Change("one_of", "One of these changed.")) == next_step(found)


def test_a_remainder_gives_joint_variable_and_what_to_do() -> None:
    found = replace(synthetic(), verdict="unexplained", remainder=Remainder(2, "torque2", "slow v"))
    assert next_step(found).startswith("The residual torque is at joint 2 and depends on the speed (slow v). Record "
                                       "slow ramps with holds")
    sensor = replace(found, remainder=Remainder(None, "gyro", "v1^2"))
    assert next_step(sensor).endswith("Check that sensor: legid calibrate imu --rig RIG")


def test_every_law_of_the_residual_has_its_variable() -> None:
    expected = {"q^3": "q", "q sign v": "v", "cos 2q": "q", "session sign v": "session", "u^2": "u", "low u": "u",
                "a^2": "a", "other's q": "other", "time": "time", "v^3": "v"}
    assert {law: variable_of(law) for law in expected} == expected
    assert {variable_of(law) for law in (*TORQUE_LAWS, *READINGS)} <= set(RECORD)


def test_commands_for_sensors_exist() -> None:
    for command in SENSORS.values():
        assert command.split()[1] in {"calibrate", "doctor"}
        assert options_of(command.split()[1]) is not None


def test_a_model_that_was_written_is_not_made_again_and_a_rig_inside_runs_is_not_asked_for() -> None:
    found = replace(synthetic(), verdict="named")
    assert with_names(next_step(found), FILES) == ("Validate the extended model on new runs: legid validate ext.json "
                                                   "NEW_RUN... --rig leg.toml")
    inside = with_names(next_step(found), Files(("a.mcap",)))
    assert inside.endswith("legid diagnose a.mcap --model-out MODEL.json, then legid validate MODEL.json NEW_RUN...")
    many = Files(("r.csv",) * 20, "x.toml")
    assert with_names("Fit: legid fit RUN... --rig RIG", many).endswith("RUN... --rig x.toml")
    session = "legid excite --rig RIG --session NEXT"
    assert with_names(session, Files(("a.mcap",))) == session
