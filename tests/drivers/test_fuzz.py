"""A short run of the fuzz study: no crash, every broken frame counted, nothing wrong beyond the check sum's odds."""

import pytest

from evidence.fuzz_codecs import fuzz_can, fuzz_serial


@pytest.mark.parametrize("seed", [1, 2])
def test_serial(seed: int) -> None:
    out = fuzz_serial(10_000, seed)
    assert out.broken > 6000
    # duplicates, swaps and drops leave whole frames; what is left of the broken ones is counted
    assert out.counted > 0.7 * out.broken
    assert out.wrong <= 3  # the odds of four are 1 in 10^5


@pytest.mark.parametrize("seed", [1, 2])
def test_can(seed: int) -> None:
    out = fuzz_can(10_000, seed)
    assert out.broken > 2000
    assert out.counted > 0.9 * out.broken
    assert out.wrong <= 4
