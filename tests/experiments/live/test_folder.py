"""Whoever can write into the current folder, or into that of the runs, decides nothing that is run."""

import asyncio
import os
from pathlib import Path

import pytest

from daq import read_rig_file
from experiments.live import children, started_demo_rig
from experiments.live.bench import Bench
from experiments.live.session import Phase, Session
from experiments.workflows.executor import LocalExecutor
from tests.support.paths import DEMO_RIG
from tests.support.processes import ran

NAMES = ("msgspec", "numpy", "pickle", "struct", "socket", "can", "nicegui", "mcap", "sitecustomize", "encodings",
         "multiprocessing", "concurrent", "selectors", "experiments", "daq", "drivers", "estimator", "legid")


@pytest.fixture
def folder(here: Path) -> Path:
    """The current folder, full of modules that leave a mark when they are imported."""
    for name in NAMES:
        for path in (here / f"{name}.py", here / name / "__init__.py"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"open({str(here / 'ran')!r}, 'a').write(__name__)\n")
    return here


def halved(x: float) -> float:
    return 0.5 * x


def test_commands_of_the_dashboard_import_nothing_from_where_it_was_started(
        folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def version() -> bytes:
        child = await children.start(["--version"], stdout=asyncio.subprocess.PIPE)
        return (await child.communicate())[0]

    monkeypatch.setenv("PYTHONPATH", os.pathsep + os.environ.get("PYTHONPATH", ""))  # an empty entry is this folder
    assert asyncio.run(version()).startswith(b"legid ")
    assert not (folder / "ran").exists()


def test_the_emulated_rig_of_the_dashboard_neither(folder: Path) -> None:
    with started_demo_rig(folder / "rig") as path:
        assert path.is_file()
    assert not (folder / "ran").exists()


def test_workers_neither(folder: Path) -> None:
    """As of the command `legid`, whose first place to look in is the folder of the command itself."""
    code = ("from experiments.workflows.executor import LocalExecutor; from math import sqrt\n"
            "if __name__ == '__main__': print(sorted(LocalExecutor(2).run(sqrt, [4.0, 9.0])))")
    script = folder / "bin/script.py"
    script.parent.mkdir()
    script.write_text(code)
    assert ran(script, cwd=folder).stdout == "[(0, 2.0), (1, 3.0)]\n"
    assert not (folder / "ran").exists()
    assert sorted(LocalExecutor(2).run(halved, [4.0, 9.0])) == [(0, 2.0), (1, 4.5)]
    assert "PYTHONSAFEPATH" not in os.environ


def test_a_report_that_leads_out_of_the_folder_is_none(tmp_path: Path) -> None:
    (out := tmp_path / "out").mkdir()
    (tmp_path / "secret.html").write_text("secret")
    (out / "link.html").symlink_to(tmp_path / "secret.html")
    os.link(out / "link.html", out / "linked.html", follow_symlinks=False)
    os.mkfifo(out / "pipe.html")
    (out / "folder.html").mkdir()
    (out / "own.html").write_text("own")
    bench = Bench(read_rig_file(DEMO_RIG), tmp_path, out)
    found = {name: bench.report(name) for name in ("link.html", "linked.html", "pipe.html", "folder.html", "own.html",
                                                   "../secret.html", "a" * 300 + ".html", "own.html/../../secret.html")}
    assert [name for name, path in found.items() if path] == ["own.html"]


def test_runs_that_vanish_or_are_none_are_not_listed(tmp_path: Path) -> None:
    (tmp_path / "dangling.mcap").symlink_to(tmp_path / "nothing")
    (tmp_path / "itself.mcap").symlink_to(tmp_path / "itself.mcap")
    (tmp_path / "folder.mcap").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / os.fsdecode(b"\xff.mcap")).write_bytes(b"")
    (tmp_path / "own.mcap").write_bytes(b"")
    os.mkfifo(tmp_path / "plan.csv")
    (tmp_path / "plan2.csv").symlink_to("/dev/zero")
    bench = Bench(read_rig_file(DEMO_RIG), tmp_path, tmp_path)
    assert [path.name for path in bench.runs()] == ["own.mcap"] and bench.plans == []


def test_a_recorder_that_cannot_be_started_leaves_no_run_that_nobody_can_end(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def start(*_: object, **__: object) -> None:
        raise MemoryError("no memory for a process")

    monkeypatch.setattr(children, "start", start)
    session = Session(tmp_path / "rig.toml", tmp_path)
    asyncio.run(session.start(tmp_path / "plan.csv"))
    assert session.phase is Phase.FAILED and "no memory" in session.words and not session.running
