"""Import in any order, repeated and interrupted: what it leaves is read, and taken by the next import."""

import os
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from daq.runs import read_csv
from experiments.cli import main

COLUMNS = ('[columns.q1_rad]\nname = "pos"\nunit = "deg"\n[columns.tau1_nm]\nname = "effort"\n'
           '[columns.time_s]\nname = "t"\n')


def logs(folder: Path, rng: np.random.Generator) -> list[str]:
    """Four files of another program; one of them lacks the angle."""
    files = []
    for k in range(4):
        t = np.arange(60 + 20 * k) * 0.01
        table = np.stack([t, 30.0 * np.sin(t), rng.normal(size=t.size)], axis=1)
        header = "t,pos,effort" if k != 2 else "t,other,effort"
        np.savetxt(folder / f"log{k}.csv", table, delimiter=",", header=header, comments="")
        files.append(str(folder / f"log{k}.csv"))
    return files


def stopping(step: Callable[[object, object], None], after: int, stops: list[str]) -> Callable[[object, object], None]:
    """`step`, interrupted from its call number `after` on; each interruption is added to `stops`."""
    calls = count()

    def call(source: object, target: object) -> None:
        if next(calls) >= after:
            stops.append(str(target))
            raise KeyboardInterrupt
        step(source, target)

    return call


@pytest.mark.parametrize("seed", range(12))
def test_any_order_repetition_or_interruption(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    files, out = logs(tmp_path, rng), tmp_path / "runs"
    (tmp_path / "c.toml").write_text(COLUMNS)
    end = ["--map", str(tmp_path / "c.toml"), "--out", str(out)]
    stops: list[str] = []
    for _ in range(4):
        chosen = [str(file) for file in rng.permutation(files)[:rng.integers(1, 5)]]
        after = int(rng.integers(0, 3))
        with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
            for name in ("link", "replace"):  # the last step of a new file, and of one that is replaced
                patch.setattr(os, name, stopping(getattr(os, name), after, stops))
            main(["import", *chosen, *end, "--force"])
        for written in out.glob("*.csv"):
            assert len(read_csv(written).time_s) >= 60
    assert stops
    assert main(["import", *rng.permutation(files), *end]) == 2  # log2 lacks the angle
    runs = sorted(out.glob("*.csv"))
    assert [run.name for run in runs] == ["log0.csv", "log1.csv", "log3.csv"]
    assert [len(read_csv(run).time_s) for run in runs] == [60, 80, 120]
    (tmp_path / "same.toml").write_text('[columns.q1_rad]\nname = "q1_rad"\n')
    again = ["--map", str(tmp_path / "same.toml"), "--out", str(tmp_path / "again")]
    assert main(["import", *map(str, runs), *again]) == 0
