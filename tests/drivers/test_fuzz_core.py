"""The firmware's core, with sanitizers, under broken frames: a short run of `make fuzz`, and that it would be seen."""

import shutil
import subprocess
from pathlib import Path

import pytest

from evidence.fuzz_core import CORE, SOURCES, build
from tests.support.c_firmware import compiler

WRONG = {  # file, what stands there, what does not hold then
    "leg_core.c": ("return core->starved ? 0 : core->torque_unm;", "return core->torque_unm;"),
    "leg_codec.c": ("if (end > size)", "if (0)"),
}


@pytest.fixture(scope="module")
def gcc() -> str:
    found = compiler()
    probe = subprocess.run([found, "-fsanitize=address,undefined", "-x", "c", "-", "-o", "/dev/null"],
                           input="int main(void) { return 0; }", text=True, capture_output=True)
    if probe.returncode:
        pytest.skip(f"{found} has no sanitizers here")
    return found


def test_nothing_breaks_the_core(gcc: str, tmp_path: Path) -> None:
    done = subprocess.run([build(gcc, tmp_path / "fuzz"), "200000", "1"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    counts = [int(word) for word in done.stdout.split() if word.isdecimal()]
    assert min(counts) > 5000  # it was armed, driven, had faults, dropped frames, ignored late ones


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_core_that_errs_is_found_out(gcc: str, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = shutil.copytree(CORE, tmp_path / "core")
    right, wrong = WRONG[name]
    text = (broken / name).read_text()
    assert text.count(right) == 1
    (broken / name).write_text(text.replace(right, wrong))
    monkeypatch.setattr("evidence.fuzz_core.SOURCES", [SOURCES[0], *(broken / p.name for p in SOURCES[1:])])
    done = subprocess.run([build(gcc, tmp_path / "fuzz"), "300000", "1"], capture_output=True)
    assert done.returncode
