"""Kernels: compiled once, kept in Numba's cache, and never fed what they do not expect."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
from pytest import MonkeyPatch, fixture, mark, raises

from estimator.numerics import compile_kernel
from tests.support.paths import ROOT

OTHER = """
from tests.estimator.numerics.test_kernel import scaled, sum_of
kernel = scaled(2.0)
print(sum_of(kernel), sum(kernel.stats.cache_hits.values()))
"""


def scaled(factor: float) -> Callable[..., None]:
    """out[row] += factor * a[row]."""

    def run(a: Any, row: int, out: Any) -> None:
        for c in range(a.shape[1]):
            out[row, c] += factor * a[row, c]

    return compile_kernel(run, "f2 n f2")


@fixture
def cache(tmp_path: Path, monkeypatch: MonkeyPatch) -> Path:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def sum_of(kernel: Callable[..., None]) -> float:
    out = np.ones((2, 3))
    kernel(np.arange(6.0).reshape(2, 3), 1, out)
    return float(out.sum())


def files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*.nb*") if path.is_file()}


def test_a_second_process_loads_what_the_first_has_compiled(cache: Path) -> None:
    assert sum_of(scaled(2.0)) == 6.0 + 2.0 * (3 + 4 + 5)
    kept = files(cache)
    done = subprocess.run([sys.executable, "-c", OTHER], cwd=ROOT, capture_output=True, text=True, timeout=120,
                          env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)})
    assert done.stdout == "30.0 1\n", done.stderr
    assert kept and files(cache) == kept


def test_another_constant_is_another_file(cache: Path) -> None:
    assert sum_of(scaled(2.0)) == 30.0
    kept = files(cache)
    assert sum_of(scaled(3.0)) == 42.0
    other = files(cache) - kept
    assert len(kept) == len(other) == 2  # an index and its only code


def test_a_file_cut_short_is_not_used(cache: Path) -> None:
    assert sum_of(scaled(2.0)) == 30.0
    for path in files(cache):
        path.write_bytes(path.read_bytes()[:-7])
    assert sum_of(scaled(2.0)) == 30.0


def test_on_a_full_disk_a_kernel_works_all_the_same(cache: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limit[1]))
    try:
        kernel = scaled(4.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert sum_of(kernel) == 54.0 and not any(path.stat().st_size for path in files(cache))


def test_without_a_folder_a_kernel_works_all_the_same(monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_LOCATOR_CLASSES", "IPythonCacheLocator")  # none for a plain file
    assert sum_of(scaled(4.0)) == 54.0


@mark.parametrize("wrong", [np.zeros((2, 3), dtype=np.float32), np.zeros(6), np.zeros((3, 2)).T,
                                   np.zeros((2, 6))[:, ::2], np.zeros((2, 3), dtype=np.int64)])
def test_an_array_of_another_kind_is_refused(wrong: np.ndarray) -> None:
    with raises(TypeError, match="No matching definition"):
        scaled(2.0)(wrong, 0, np.ones((2, 3)))


@mark.usefixtures("cache")
def test_threads_that_ask_at_once_have_one_answer() -> None:
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: sum_of(scaled(5.0)), range(8))) == {66.0}
