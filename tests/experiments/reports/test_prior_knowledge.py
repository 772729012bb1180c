"""A fit with [prior]: said first on the terminal and the page, in the JSON and MODEL.json; bad entries are refused."""

import re
from pathlib import Path

import pytest

from daq import InputError, parse_rig
from tests.support.imported_files import table_of
from tests.support.mujoco_leg import Leg, record
from tests.support.shell import Shell, document, read_json

LEG = Leg()
RIG = """[mechanism]
model = "leg2"
actuated = [2]
[terms]
rotor_inertia = []
torque_offset = []
encoder_zero = []
[imu]
lever_arm_m = 0.2
[prior]
"""


@pytest.fixture(scope="module")
def run(module_path: Path) -> Path:
    return table_of(record(LEG, 3, seconds=10.0, amplitude=0.3, high=2.0),
                    module_path / "small.csv")


def rig_with(folder: Path, *entries: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(RIG + "\n".join(entries) + "\n")
    return path


def test_a_prior_is_said_first_and_everywhere(run: Path, here: Path, shell: Shell) -> None:
    rig = rig_with(here, f"l1 = [{LEG.l1}, 0.003]", f"beta5 = [{LEG.beta()[4]}, 0.002]")
    page, model = here / "fit.html", here / "model.json"
    found = document("fit", run, "--rig", rig, "--html fit.html --model-out model.json")
    assert ("Maximum a posteriori: the fit used what [prior] says (l1 = 0.3 +- 0.003, beta5 = 0.12 +- 0.002)"
            in shell.out)
    assert [one["name"] for one in found["prior"]] == ["l1", "beta5"]
    assert read_json(model)["provenance"]["prior"]["l1"] == [0.3, 0.003]
    summary = re.sub(r"<[^>]+>", " ", page.read_text())
    assert "Maximum a posteriori" in summary and "What was known before" in summary


def test_a_prior_that_the_runs_contradict_is_not_trusted(run: Path, tmp_path: Path, shell: Shell) -> None:
    shell("fit", run, "--rig", rig_with(tmp_path, "l1 = [0.33, 0.005]"))
    assert "The runs contradict [prior] l1 = 0.33 +- 0.005" in shell.out


@pytest.mark.parametrize("entry", ["m1 = [1.0]", "m1 = [1.0, 0.0]", "m1 = [1.0, nan]", "m1 = [1.0, 0.1, 2.0]"])
def test_an_entry_without_a_standard_deviation_is_refused(entry: str) -> None:
    with pytest.raises(InputError, match=r"prior\.m1 is .*give its value and standard deviation"):
        parse_rig(RIG + entry)


def test_a_name_that_the_mechanism_does_not_have_is_refused(run: Path, tmp_path: Path, shell: Shell) -> None:
    said = shell.fails("fit", run, "--rig", rig_with(tmp_path, "m7 = [1.0, 0.1]"))
    assert "[prior] m7 is nothing that leg2 has" in said
