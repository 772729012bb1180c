"""docs/tutorial.md as a new user goes through it: every command, in order, and what the page says that it prints."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from experiments.emulation import EFFECTS, LegBody
from experiments.emulation.hidden_effects import REST_RAD, SPRING_NM
from tests.support.paths import ROOT
from tests.tools.tutorial import INSTALL, PAGE, POSITIONS, Block, blocks, run_blocks, shortened

TEXT = PAGE.read_text(encoding="utf-8")
VARIES = re.compile(r"(?<=by legid )\S+|[-+]?\d[\d.,:e+-]*|-{2,}|\s+")
"""The version, numbers, rules under headings and spaces: the commit, the machine's arithmetic and the clock decide
about them."""

SWAYS = re.compile(r"(?m)^(assumed: (torque acts|friction smoothing)|Wide intervals|[Rr]uns disagree|"
                   r"warning: \d+ % of).*\n")


def printed(some: list[Block], home: Path) -> Path:
    """The directory that blocks leave behind, of which each printed what the page shows."""
    if shutil.which("bash") is None:
        pytest.skip("no bash")
    folder = home / "my-leg"
    folder.mkdir()
    for block, said in zip(some, run_blocks(some, folder)):
        assert block.text is None or words(block.text) == words(shortened(said, block.first)), block.code
    return folder


def test_no_command_escapes_the_test() -> None:
    found = blocks(TEXT)
    assert TEXT.count("```sh") == len(found) and len(found) >= 6
    assert TEXT.count("```") == 2 * (len(found) + sum(block.text is not None for block in found))
    assert found[0].code.splitlines() == INSTALL


def test_make_knows_how_to_install() -> None:
    if shutil.which("make") is None:
        pytest.skip("no make")
    done = subprocess.run(["make", "-n", "-B", "install"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "-m venv .venv" in done.stdout and "requirements.lock" in done.stdout


@pytest.mark.slow
def test_every_command_prints_what_the_page_shows_and_the_spring_is_found(tmp_path: Path) -> None:
    folder = printed(blocks(TEXT)[1:], tmp_path)
    found = json.loads((folder / "diagnosis.json").read_text())
    assert found["verdict"] == "named"
    (cause,) = found["causes"]
    stiffness, preload = (size["value"] for size in cause["size"])
    assert cause["effect"] == "joint_stiffness" and cause["joint"] == 2
    assert stiffness == pytest.approx(SPRING_NM, rel=0.03) and preload / stiffness == pytest.approx(REST_RAD, rel=0.05)
    knee = found["gain"]["free_run_rmse"]["q2_rad"]
    assert knee["before"] > 0.05 and knee["after"] < 0.15 * knee["before"]
    assert f"true beta1 is {LegBody().beta()[0]:.3f} kg m^2" in TEXT
    assert {"fit.html", "diagnosis.html", "simulated.csv"} <= {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_the_page_of_positions_prints_what_it_shows(tmp_path: Path) -> None:
    some = blocks(POSITIONS.read_text(encoding="utf-8"))
    assert len(some) >= 7 and all(block.text is not None for block in some)
    printed(some, tmp_path)


def test_what_the_page_hides_can_be_hidden() -> None:
    assert set(re.findall(r"--emulate (\w+)", TEXT)) <= {*EFFECTS, "none"}


def words(text: str) -> list[str]:
    """Lines without what varies; runners-up whose scores are close may change places, and what a threshold decides of a
    fit that is wrong, as the page's first one is, may hang on the last digit."""
    text = SWAYS.sub("", text)
    text = re.sub(r"(?s)(Runners-up.*?\n-.*?\n).*?\n\n", r"\1", text)
    return [line for line in (" ".join(VARIES.sub(" ", line).split()) for line in text.splitlines()) if line]
