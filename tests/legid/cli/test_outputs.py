"""Every command that writes a file: not over a run, not unasked over what is none of its own."""

import argparse
from pathlib import Path

import pytest

from legid.cli.main import build_parser
from tests.support.shell import Shell

RUN = b"time_s,q2_rad,tau2_nm\n0.0,0.1,0.2\n0.01,0.1,0.2\n"
NOTES = b"what I measured today\n"
FIT, DIAGNOSE = "fit none.csv --rig none.toml", "diagnose none.csv --rig none.toml"
OUTPUTS = [
    f"{FIT} --json", f"{FIT} --html", f"{FIT} --model-out", f"{FIT} --each --json",
    *(f"{how} --rig none.toml --{what}" for what in ("json", "html")
      for how in ("validate none.json none.csv", "compare none.json none.json none.csv")),
    f"{DIAGNOSE} --json", f"{DIAGNOSE} --html", f"{DIAGNOSE} --model-out",
    "simulate none.json --plan none.csv --out", "excite --rig none.toml --out",
    *(f"export none.csv --to {kind} --out" for kind in ("csv", "mat", "parquet")),
    "export none.json --to mjcf --out", "export none.json --to urdf --out", "export none.mcap --to ros2 --out",
    "effects --json", "runs . --json", "tune none.csv --json", "casebook . --json", "casebook . --html",
    "monte-carlo biped3 --json", "record --rig none.toml --plan none.csv --out", "recover none.mcap --out",
]


@pytest.mark.parametrize("command", OUTPUTS, ids=lambda c: f"{c.split()[0]} {c.split()[-1]}")
def test_no_command_destroys_a_run_or_unasked_another_file(
        command: str, here: Path, shell: Shell) -> None:
    target = Path("target")
    forced = [] if command.startswith("rec") else ["--force"]
    target.write_bytes(RUN)
    assert "never overwritten" in shell.fails(command, "target", *forced)
    assert target.read_bytes() == RUN
    target.write_bytes(NOTES)
    assert "--force" in shell.fails(command, "target") or not forced
    assert target.read_bytes() == NOTES and [p.name for p in Path().iterdir()] == ["target"]


def test_every_argument_that_names_a_file_to_write_is_checked() -> None:
    (commands,) = (a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
    covered = {(c.split()[0], c.split()[-1]) for c in OUTPUTS}
    for name, parser in commands.choices.items():
        checked = {dest for dest, _ in parser.get_default("outputs") or ()}
        for action in parser._actions:
            if action.dest in ("json", "html", "model_out", "out") and action.metavar != "DIR":
                assert action.dest in checked, f"{name} {action.option_strings}"
                assert (name, action.option_strings[-1]) in covered


def test_two_outputs_in_one_place_are_refused(shell: Shell) -> None:
    assert "--json names too" in shell.fails(FIT, "--json x.json --model-out x.json")


def test_an_output_of_the_same_kind_is_replaced(here: Path, shell: Shell) -> None:
    path = here / "effects.json"
    shell("effects --json effects.json")
    path.write_text(path.read_text()[:60] + "...")
    shell("effects --json effects.json")
    assert path.read_text().endswith("}\n")
    path.write_bytes(NOTES)
    shell("effects --json effects.json --force")


def test_a_demo_replaces_no_run_but_its_own(tmp_path: Path, shell: Shell) -> None:
    from daq.runs.mcap_run import RunWriter

    with_own = tmp_path / "demo-run1.mcap"
    RunWriter(with_own, {}).close()
    assert "not of an earlier demo" in shell.fails("demo --out", tmp_path)
    assert with_own.exists()
