"""Kernels: compiled once, kept, loaded without the compiler, and never fed what they do not expect."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator.numerics import Kernel, jit
from tests.support.paths import ROOT

OTHER = """
import sys
import numpy as np
from tests.estimator.numerics.test_jit import scaled
out = np.ones((2, 3))
scaled(2.0)(np.arange(6.0).reshape(2, 3), 1, out)
print(out.sum(), "numba" in sys.modules)
"""


def scaled(factor: float) -> Kernel:
    """out[row] += factor * a[row]."""

    def run(a: Any, row: int, out: Any) -> None:
        for c in range(a.shape[1]):
            out[row, c] += factor * a[row, c]

    return Kernel(run, "f2 n f2")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(jit.HOME_VARIABLE, str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def sum_of(kernel: Kernel) -> float:
    out = np.ones((2, 3))
    kernel(np.arange(6.0).reshape(2, 3), 1, out)
    return float(out.sum())


def test_a_second_process_loads_what_the_first_has_compiled(cache: Path) -> None:
    assert sum_of(scaled(2.0)) == 6.0 + 2.0 * (3 + 4 + 5)
    (kept,) = cache.iterdir()
    done = subprocess.run([sys.executable, "-c", OTHER], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, timeout=60)
    assert done.stdout == "30.0 False\n", done.stderr
    assert list(cache.iterdir()) == [kept]


def test_another_constant_is_another_kernel_and_a_damaged_file_is_none(cache: Path) -> None:
    assert (sum_of(scaled(2.0)), sum_of(scaled(3.0))) == (30.0, 42.0)
    for path in cache.iterdir():
        path.write_bytes(path.read_bytes()[:-7])
    assert sum_of(scaled(2.0)) == 30.0


def test_without_a_place_to_keep_it_a_kernel_works_all_the_same(tmp_path: Path,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(jit.HOME_VARIABLE, str(tmp_path / "file" / "below"))
    assert sum_of(scaled(4.0)) == 54.0


def test_a_full_disk_keeps_nothing_of_a_kernel(tmp_path: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limit[1]))
    try:
        jit._keep(tmp_path / "k.o", b"code" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", [np.zeros((2, 3), dtype=np.float32), np.zeros(6), np.zeros((3, 2)).T,
                                   np.zeros((2, 6))[:, ::2], np.zeros((2, 3), dtype=np.int64)])
def test_an_array_of_another_kind_is_refused(wrong: np.ndarray) -> None:
    with pytest.raises(TypeError, match="argument 0 of scaled"):
        scaled(2.0)(wrong, 0, np.ones((2, 3)))


@pytest.mark.usefixtures("cache")
def test_a_kernel_that_makes_arrays_is_refused() -> None:
    def run(a: Any) -> None:
        work = np.zeros(a.size)
        for i in range(a.size):
            work[i] = a[a.size - 1 - i]
        for i in range(a.size):
            a[i] = work[i]

    with pytest.raises(TypeError, match="makes arrays or may fail"):
        Kernel(run, "f1")(np.zeros(3))


@pytest.mark.usefixtures("cache")
def test_threads_that_ask_at_once_share_one() -> None:
    kernel = scaled(5.0)
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: sum_of(kernel), range(8))) == {66.0}
