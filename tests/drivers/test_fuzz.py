"""A short run of the fuzz study: no crash, every broken frame counted, nothing wrong beyond the check sum's odds."""

from collections.abc import Callable
from typing import Any

import pytest

from evidence.fuzz_codecs import fuzz_can, fuzz_serial


@pytest.mark.parametrize("fuzz, broken, share, wrong", [(fuzz_serial, 6000, 0.7, 3), (fuzz_can, 2000, 0.9, 4)])
@pytest.mark.parametrize("seed", [1, 2])
def test_broken_frames_are_counted_and_hardly_one_is_taken_for_another(
        fuzz: Callable[..., Any], broken: int, share: float, wrong: int, seed: int) -> None:
    """Duplicates, swaps and drops leave whole frames; the odds of four wrong serial ones are 1 in 10^5."""
    out = fuzz(10_000, seed)
    assert out.broken > broken and out.counted > share * out.broken and out.wrong <= wrong
