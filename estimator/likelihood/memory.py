"""`keep_pages`: memory that steps of a fit give back and take again; `pieces`: what is worked on at a time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from estimator.model import Samples


@cache
def keep_pages() -> None:
    """Make the C library keep memory that arrays gave back, up to 64 MB of it, instead of the system.

    A step makes and drops arrays of megabytes, and the system hands out every page of them anew and cleared: on a
    virtual machine half of a fit's time went there. GNU's allocator takes the largest block freed so far, up to 32 MB,
    for the size below which it keeps what is freed; this block is freed without ever being touched. Elsewhere it does
    nothing.
    """
    np.empty(31 * 2**20, dtype=np.uint8)


def pieces(samples: NDArray[np.intp], size: int) -> Iterator[tuple[slice, Samples]]:
    """`samples` piece by piece, `size` at a time: which of them, and those themselves.

    Slices wherever a piece has no gap: they cost no copies.
    """
    for start in range(0, samples.size, size):
        part = samples[start : start + size]
        first, last = int(part[0]), int(part[-1])
        if last - first == part.size - 1:
            yield slice(start, start + part.size), slice(first, last + 1)
        else:
            yield slice(start, start + part.size), part
