"""`keep_pages`: memory that steps of a fit give back and take again; `pieces`: what is worked on at a time;
`refuse_too_long`: records that no memory of this machine holds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache

import numpy as np

from daq import IndexArray
from estimator.errors import FitError
from estimator.model import Samples

COPIES = 4
"""Times the size of the normal equations that a step takes at its peak. (Measured: 4.2 kB a sample of a leg with an IMU
over 60,000 samples, 5.5 kB with everything else that a command holds over 360,000.)"""


@cache
def keep_pages() -> None:
    """Make the C library keep memory that arrays gave back, up to 64 MB of it, instead of the system.

    A step makes and drops arrays of megabytes, and the system hands out every page of them anew and cleared: on a
    virtual machine half of a fit's time went there. GNU's allocator takes the largest block freed so far, up to 32 MB,
    for the size below which it keeps what is freed; this block is freed without ever being touched. Elsewhere it does
    nothing.
    """
    np.empty(31 * 2**20, dtype=np.uint8)


def pieces(samples: IndexArray, size: int) -> Iterator[tuple[slice, Samples]]:
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


def refuse_too_long(samples: int, block: int, width: int) -> None:
    """Raise `FitError` where a step on so many `samples` needs more memory than the machine has.

    The normal equations hold two blocks a sample and `width` right sides.
    """
    need, machine = COPIES * 8 * samples * block * (2 * block + width), physical_memory()
    if need > machine:
        raise FitError(f"a fit of {samples} samples needs about {need / 1e9:.2g} GB of memory, and this machine has "
                       f"{machine / 1e9:.2g} GB: lower rate_hz under [sampling], or fit fewer or shorter runs")


def physical_memory() -> float:
    """Memory of this machine [bytes]; inf where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return float("inf")
