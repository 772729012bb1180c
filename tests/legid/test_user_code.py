"""What a user writes: the first script of the README runs as it stands, and types of results are known to mypy."""

import re
from pathlib import Path

import pytest

import legid
from daq import InputError
from tests.support.imported_files import degrees_log
from tests.support.paths import ROOT
from tests.support.processes import ran

README = (ROOT / "README.md").read_text(encoding="utf-8")
SCRIPT = re.findall(r"^```python\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
MOST_LINES = 15
TYPED = """
import legid

run = legid.load("run.csv", "rig.toml")
seen = legid.validate("model.json", run)
level: str = seen.trust.level
errors: dict[str, float | None] = seen.horizons[0].rmse
first: legid.Validation = seen[0]
same = legid.Validations.read("validation.json").runs[0].start_s
fit = legid.fit(run)
trusted: bool = fit.trust.level == "good"
value: float | None = fit.parameters[0].value
half: float = float(fit.ci95()[0, 1] - fit.beta[0])
widened = [row.widened for row in fit.agreement.parameters] if fit.agreement else []
found = legid.diagnose(run)
size: float = found.causes[0].size[0].value
after: float = found.sensors["q2_rad"].after
closed: float | None = found.gain.gap_closed
better: str | None = legid.compare(legid.load_model("a.json"), legid.load_model("b.json"), [run]).errors[0].better
"""
WRONG = {"wrong: int = seen.trust": "incompatible type", "seen.no_such_key": "no attribute",
         "fit.no_such_key": "no attribute", "found.no_such_key": "no attribute"}
"""Line -> what mypy says of it."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two logs of one leg under another program's names, and its rig."""
    monkeypatch.setenv("MYPYPATH", str(ROOT))  # mypy does not follow the finder of an editable install
    for seed, name in ((11, "log"), (12, "log2")):
        degrees_log(tmp_path / f"{name}.csv", seed)
    (tmp_path / "rig.toml").write_text('[mechanism]\nmodel = "leg2"\nactuated = [2]\n')
    return tmp_path


def test_the_first_script_runs_in_at_most_fifteen_lines(folder: Path) -> None:
    (script,) = SCRIPT
    assert len(script.splitlines()) <= MOST_LINES
    (folder / "first.py").write_text(script)
    said = ran("first.py", cwd=folder).stdout
    assert said.startswith("TRUST the parameters") and "m2*l1*lc2" in said
    assert (folder / "leg/leg.xml").is_file() and "<svg" in (folder / "diagnosis.html").read_text()
    assert {path.name for path in folder.iterdir()} >= {"fit.html", "extended.json"}


def test_a_log_in_amperes_is_read_with_its_scale(folder: Path) -> None:
    """The script stopped at amperes: a column's scale could not be given, and the guess's warning was not printed."""
    (given,) = re.findall(r"`(legid\.guess\(.*scale=.*\))`", README)
    log = folder / "log.csv"
    log.write_text(log.read_text().replace("Torque [Nm]", "Current [A]"))
    (folder / "amperes.py").write_text(f"""import legid
columns = {given}.columns
print(columns["tau2_nm"].scale, len(legid.read("log.csv", columns, rig="rig.toml")))
print(len(legid.read("log.csv", legid.guess("log.csv").columns, scale={{"tau2_nm": 0.12}})))
""")
    done = ran("amperes.py", cwd=folder)
    assert done.stdout.split() == ["0.12", "1000", "1000"]
    assert done.stderr.count("UserWarning: the scale of tau2_nm does not show") == 1  # of the guess without it
    with pytest.raises(InputError, match="tau1_nm is no column of the map"):
        legid.guess(log, scale={"tau1_nm": 2.0})


def test_mypy_strict_knows_the_types_of_results(folder: Path) -> None:
    (folder / "first.py").write_text(SCRIPT[0])
    (folder / "typed.py").write_text(TYPED)
    mypy = "-m", "mypy", "--strict", "--follow-imports=silent"
    ran(*mypy, "first.py", "typed.py", cwd=folder)
    (folder / "wrong.py").write_text("\n".join([TYPED, *WRONG]))
    said = ran(*mypy, "wrong.py", cwd=folder, status=1).stdout.splitlines()
    assert len(said) == len(WRONG) + 1 and all(told in line.lower() for line, told in zip(said, WRONG.values()))
