"""`keep_pages`: memory that steps of a fit give back and take again."""

from __future__ import annotations

from functools import cache

import numpy as np


@cache
def keep_pages() -> None:
    """Make the C library keep memory that arrays gave back, up to 64 MB of it, instead of the system.

    A step makes and drops arrays of megabytes, and the system hands out every page of them anew and cleared: on a
    virtual machine half of a fit's time went there. GNU's allocator takes the largest block freed so far, up to 32 MB,
    for the size below which it keeps what is freed; this block is freed without ever being touched. Elsewhere it does
    nothing.
    """
    np.empty(31 * 2**20, dtype=np.uint8)
