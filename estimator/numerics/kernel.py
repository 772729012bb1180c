"""`compile_kernel`: a function on arrays as machine code, by Numba and its cache.

Numba keeps the code in $NUMBA_CACHE_DIR, else next to the source, else in the user's cache folder.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np

at = np.uint64
"""A sum of indices as the compiler needs it to know that it does not count from an array's end."""


def compile_kernel(function: Callable[..., None], kinds: str, exact: bool = False) -> Callable[..., None]:
    """`function` as machine code, compiled once on a machine and loaded after that.

    `kinds` has a word an argument: "f3" an array of float64 with three axes, "i1" one of int64 with one, "d" a float,
    "n" an integer. Arrays are contiguous; anything else is a TypeError. The function returns nothing. `exact` keeps
    sums in the order in which they are written. Without a writable folder each process compiles again.
    """
    import numba  # takes half a second, which commands that fit nothing do not wait for

    # One cache file for each set of constants: processes that compile at once would number them alike in a common one.
    constants = [cell.cell_contents for cell in function.__closure__ or ()]
    function.__qualname__ = "_".join(map(str, [function.__qualname__, *constants]))
    numbers = {"f": numba.float64, "i": numba.int64, "d": numba.float64, "n": numba.int64}
    signature = numba.void(*(numba.types.Array(numbers[kind[0]], int(kind[1]), "C") if kind[1:] else numbers[kind]
                             for kind in kinds.split()))
    loose = {"contract", "nsz"} if exact else {"contract", "nsz", "reassoc"}
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": loose}
    try:
        return numba.njit(signature, cache=True, **options)(function)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError):  # no folder, a full disk, a file cut short
        return numba.njit(signature, **options)(function)


def load_compiler() -> None:
    """Load Numba now: much work is to come, perhaps in processes forked from this one."""
    compile_kernel(_nothing, "d")


def _nothing(_: float) -> None:
    return
