"""Which kernel of OpenBLAS is the other one: never one that the processor lacks, never the usual one again."""

import pytest

from tests.tools import other_kernel


@pytest.mark.parametrize("flags, usual, expected", [
    ({"avx512vl", "fma"}, "SkylakeX", "Haswell"), ({"avx512vl", "fma"}, "Haswell", "SkylakeX"),
    ({"fma"}, "Haswell", None), ({"fma"}, "Zen", "Haswell"), (set(), "neoversen1", None)])
def test_the_other_kernel(flags: set[str], usual: str, expected: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_kernel, "running", lambda kernel=None: {kernel or usual})
    assert other_kernel.other_kernel(flags) == expected


def test_a_kernel_that_libraries_do_not_take_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_kernel, "running", lambda kernel=None: {"SkylakeX"})
    assert other_kernel.other_kernel({"avx512vl", "fma"}) is None
