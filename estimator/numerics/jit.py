"""`compiled`: a function made machine code by Numba, where the extra `fast` is installed.

To import Numba and fetch its kernels from disk takes half a second, as long as a fit of ten thousand samples without
them; to compile them, once on a machine, eight. So a process uses them only after it has worked for longer than
they cost to fetch.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

LOAD_WORTH = 1_000_000
"""Samples, counted once a step of a fit, that a process goes through before it loads the kernels: they save 3 us on
each, and fetching them costs half a second. So many that the first fit of 60,000 samples does not stop to compile
them."""
at = np.uint64
"""A sum of indices as the compiler needs it to know that it does not count from an array's end."""
_done = 0


@cache
def _numba() -> Any:
    """The module, or None where it is not installed or does not suit this numpy."""
    try:
        return importlib.import_module("numba")
    except ImportError:
        return None


def at_hand() -> bool:
    """Whether there are kernels at all."""
    return _numba() is not None


def note(samples: int) -> None:
    """Count a step of a fit over so many samples."""
    global _done
    _done += samples


def expect() -> None:
    """Have kernels fetched at the next step: much work is to come, perhaps in processes forked from this one."""
    global _done
    _done = LOAD_WORTH + 1


def ready() -> bool:
    """Whether work is for kernels by now."""
    return _done > LOAD_WORTH and at_hand()


def compiled(function: Callable[..., Any], exact: bool = False) -> Callable[..., Any]:
    """`function` as machine code, kept on disk for the next process. Only where they are `ready`.

    `exact` keeps sums in the order in which they are written.
    """
    loose = {"contract", "nsz"} if exact else {"contract", "reassoc", "nsz"}
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": loose}
    try:
        return _numba().njit(cache=True, **options)(function)
    except RuntimeError:  # no directory to keep it in
        return _numba().njit(**options)(function)
