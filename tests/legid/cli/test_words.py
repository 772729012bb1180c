"""What the command line says: suggestions, how much of it, nothing that steers a terminal."""

from pathlib import Path

import pytest

from experiments import console
from legid.cli.main import build_parser
from tests.support.paths import DEMO_RIG
from tests.support.shell import Shell


@pytest.mark.parametrize("args, meant", [
    ("diagnos a.csv", "diagnose"), ("fit a.csv --jsn x", "--json"), ("demo --effect stribek_friction",
    "stribeck_friction"), ("fit a.csv --method mlle", "mle")])
def test_a_misspelt_word_gets_a_suggestion(args: str, meant: str, shell: Shell) -> None:
    assert f"did you mean {meant}?" in shell.fails(args)


@pytest.mark.parametrize("right, wrong", [("lever_arm_m", "lever_arm"), ("[limits]", "[limit]")])
def test_a_misspelt_key_gets_a_suggestion(right: str, wrong: str, here: Path, shell: Shell) -> None:
    (here / "rig.toml").write_text(DEMO_RIG.read_text().replace(right, wrong))
    assert f"did you mean {right.strip('[]')}?" in shell.fails("fit a.csv --rig rig.toml")


@pytest.mark.parametrize("columns", [50, 80, 100])
def test_no_option_is_parted_at_a_hyphen(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    commands = build_parser()._commands()
    assert "diagnose" in commands
    for name, command in commands.items():
        text = command.format_help()
        assert not [line for line in text.splitlines() if line.endswith("-")], name
        for option in (o for o in command._option_string_actions if f"{o} " in (command.description or "")):
            assert option in text


def test_names_from_files_cannot_steer_the_terminal(here: Path, shell: Shell) -> None:
    path = here / "a.csv"
    path.write_text("time_s,\x1b]0;owned\x07q\x9b2J\n" + "".join(f"{k},{k}\n" for k in range(60)))
    shell("info a.csv")
    out = shell.out
    assert "owned" in out and not any(c in out for c in "\x1b\x07\x9b") and "\n" in out
    path.write_text("time_s,a\x1b[2J,a\x1b[2J\n1,2,3\n")
    assert "\x1b" not in shell.fails("info a.csv")


def test_progress_is_told_where_there_is_no_terminal(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "FIRST_LINE_S", 0.0)
    for level, lines in ((console.USUAL, 1), (console.QUIET, 0)):
        with console.verbosity(level), console.stages("diagnosing") as show:
            show("fitting", 0.25)
            show("scoring", 0.5)
        assert shell.err == "diagnosing: fitting, 25 %\n" * lines
        with console.verbosity(level):
            assert list(console.progress([1, 2, 3], "reading", unit="run")) == [1, 2, 3]
        assert shell.err == "reading: 0 of 3 runs\n" * lines


def test_quiet_and_verbose(shell: Shell) -> None:
    shell("effects --verbose")
    assert "legid effects:" in shell.err
    shell("effects --quiet")
    assert shell.err == ""


def test_info_tells_of_all_files_that_can_be_read(here: Path, shell: Shell) -> None:
    good = [here / "a.csv", here / "b.csv"]
    for path in good:
        path.write_text("time_s,q\n" + "".join(f"{k},{k}\n" for k in range(60)))
    shell("info", good[0], "none.csv", good[1], status=2)
    out, err = shell.read()
    assert "a.csv: 60 samples" in out and "b.csv: 60 samples" in out and "none.csv" in err


def test_the_ending_tells_the_format_of_an_export(here: Path, shell: Shell) -> None:
    (here / "a.csv").write_text("time_s,q\n" + "".join(f"{k / 100},{k}\n" for k in range(60)))
    shell("export a.csv --out b.mat")
    assert (here / "b.mat").read_bytes().startswith(b"MATLAB 5.0")
    assert "give --to" in shell.fails("export a.csv --out b.xyz")
