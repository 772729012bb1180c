"""What rig.toml is silent about is chosen by the records, and only what they ask for."""

from pathlib import Path

import numpy as np
import pytest

from daq.rig import parse_rig
from experiments.session.choices import choose_terms, with_choices
from experiments.workflows.fit import fit_runs
from tests.support.paths import REAL, needs_records
from tests.support.prescribed import ARM_RIG, BETA, arm_run
from tests.support.shell import document

ARMS = {"dfki_c0": (["00", "01", "02", "03", "04", "05", "06"], [0.05354, 0.05328, 0.03623, 0.24113, 0.18117]),
        "dfki_a0": (["00", "01", "02", "03", "12"], [0.11116, 0.02346, 0.03332, 0.34912, 0.11106])}


def test_terms_that_are_there_are_chosen_and_no_others() -> None:
    silent = parse_rig(ARM_RIG)
    healthy = [arm_run(k) for k in range(5)]
    assert choose_terms(healthy, silent) == ()
    assert not any("chosen" in text for text in fit_runs(healthy, silent).result.assumptions)

    zeros = [(0.05, -0.04), (-0.04, 0.05), (0.03, 0.05), (-0.05, 0.0), (0.01, -0.06)]
    lame = [arm_run(k, offset=(0.1, 0.0), rotor=0.01, zero=zero) for k, zero in enumerate(zeros)]
    chosen = {c.key: c.value for c in choose_terms(lame, silent)}
    assert chosen == {"rotor_inertia": (2,), "torque_offset": (1,), "encoder_zero": (1, 2)}
    fitted = fit_runs(lame, silent)
    assert fitted.rig == with_choices(silent, fitted.choices)
    assert np.allclose(fitted.result.beta[:5], BETA[:5], rtol=0.03)
    assert sum("chosen, where rig.toml is silent" in text for text in fitted.result.assumptions) == 3

    stated = parse_rig(ARM_RIG + "[terms]\nrotor_inertia = []\ntorque_offset = []\nencoder_zero = []\n")
    assert choose_terms(lame, stated) == ()


def test_an_offset_in_a_single_run() -> None:
    run = arm_run(1, offset=(0.0, 0.2), seconds=20.0)
    assert [(c.key, c.value) for c in choose_terms([run], parse_rig(ARM_RIG))] == [("torque_offset", (2,))]



@needs_records
@pytest.mark.parametrize("arm", [pytest.param("dfki_c0", marks=pytest.mark.study),
                                 pytest.param("dfki_a0", marks=pytest.mark.slow)])
def test_real_arms_without_a_specialist(arm: str, tmp_path: Path) -> None:
    """Mechanism, joints, gear and gravity in rig.toml, one command, no option: within 9 % of what is published."""
    runs, published = ARMS[arm]
    rig = tmp_path / "rig.toml"
    rig.write_text(ARM_RIG + "gravity_mps2 = 9.81\n[motor]\ngear_ratio = 6.0\n")
    told = document("fit", *(REAL / arm / f"{run}.csv.gz" for run in runs), "--rig", rig)
    found = [p["value"] for p in told["parameters"][:5]]
    # 0.085 and 0.067; as a fit was with nothing chosen, 0.154 and 0.154
    assert np.max(np.abs(np.array(found) / published - 1.0)) < 0.09
    assert {c["key"] for c in told["chosen"]} >= {"rotor_inertia", "encoder_zero", "encoder_rad"}
    assert not told["remedies"]
