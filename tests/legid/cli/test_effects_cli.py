"""`legid effects`, and an effect of one's own: the how-to's worked example, installed and run."""

import re
import sys
from importlib import invalidate_caches
from pathlib import Path

import numpy as np
import pytest

from estimator.effects import library
from estimator.model import leg2
from experiments.emulation import EFFECTS
from experiments.models import effects_document, known_effects
from tests.support.paths import ROOT
from tests.support.shell import Shell, document

PAGE = ROOT / "docs/effect.md"
CONTRACT = [
    "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "presliding_friction", "quadratic_drag",
    "friction_drift", "joint_stiffness", "joint_elasticity", "backlash", "rotor_inertia", "end_stop_contact",
    "base_compliance", "torque_ripple", "torque_offset", "torque_saturation", "torque_delay", "sensor_time_skew",
    "gyro_bias", "gyro_scale", "accelerometer_bias", "imu_misalignment", "imu_lever_arm", "encoder_offset",
    "encoder_scale", "encoder_eccentricity", "command_delay", "gain_scale", "missing_integral", "input_limit",
    "supply_sag", "command_dead_band", "command_steps", "load_stribeck_friction", "quadratic_load_friction",
    "directional_load_friction"]


def install(folder: Path, module: str, code: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package as pip would leave it: a module and the metadata that names its entry point."""
    (folder / f"{module}.py").write_text(code)
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[legid.effects]\nmine = {value}\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, module, raising=False)
    invalidate_caches()


def test_every_effect_of_the_contract_is_listed(shell: Shell) -> None:
    found = document("effects")
    text = shell.out
    assert found["schema"] == "legid.effects/1"
    assert sorted(row["effect"] for row in found["effects"]) == sorted(CONTRACT)
    for row in found["effects"]:
        assert row["effect"] in text and row["meaning"] and row["reference"] and row["experiment"]
        assert all(part["unit"] for part in row["sizes"] + row["shapes"]) and row["sizes"]
    behind = {row["effect"] for row in found["effects"] if row["behind_a_loop"]}
    assert behind == {"encoder_offset", "encoder_scale", "encoder_eccentricity"} and "heard_by_loop, 1 or 0" in text
    assert {row["effect"] for row in found["not_testable"]} == {"torque_gain", "payload"}
    assert all(row["why"] in re.sub(r"\s+", " ", text) for row in found["not_testable"])
    assert max(map(len, text.splitlines())) <= 110


def test_the_how_to_s_example_is_found_and_tested(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                            shell: Shell) -> None:
    text = PAGE.read_text()
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    value = re.search(r'\[project\.entry-points\."legid\.effects"\]\n\w+ = "(.*?)"', text)
    module = value.group(1).partition(":")[0]
    install(tmp_path, module, code, value.group(1), monkeypatch)
    kind = list(known_effects().values())[-1]
    assert kind.name not in CONTRACT
    shell("effects")
    assert kind.name in shell.out
    effects, _ = library(leg2(lever_arm=0.2), True)
    assert kind.name in {e.name for e in effects}
    monkeypatch.delitem(sys.modules, module)


@pytest.mark.parametrize("code, says", [
    ("import no_such_module_at_all", "no_such_module_at_all"), ("Mine = 3", "not an Effect class"),
    ("from estimator.effects import StribeckFriction as Mine", "two effects are called stribeck_friction"),
    ("from estimator.effects import TorqueEffect\nclass Mine(TorqueEffect):\n    name = 'mine'\n    plans = ('slwo',)",
     "mine asks for plans of the kind 'slwo'"),
])
def test_a_broken_effect_is_named_in_one_line(code: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                              shell: Shell) -> None:
    install(tmp_path, "broken_effect", code, "broken_effect:Mine", monkeypatch)
    error = shell.fails("effects")
    assert says in error and "legid.effects" in error
    monkeypatch.delitem(sys.modules, "broken_effect", raising=False)


def test_what_a_demo_can_hide_is_in_the_library() -> None:
    from legid.cli.arguments import HIDEABLE

    known = {row["effect"]: row for row in effects_document()["effects"]}
    assert set(HIDEABLE) == {"none", *EFFECTS}
    assert set(EFFECTS) <= set(known)
    assert len(EFFECTS) >= 8 and np.all([hidden.words for hidden in EFFECTS.values()])
