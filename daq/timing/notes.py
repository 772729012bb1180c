"""Notes of a run file on its devices, and which of its samples are in order."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from daq.dataset import FloatArray, IndexArray
from daq.errors import InputError
from daq.runs import RawRun


def configured(raw: RawRun, kind: str) -> dict[str, Any]:
    """The last configuration note of this kind in the run (`imu`, `firmware`), empty when there is none."""
    texts = [note.text for note in raw.config if note.kind == kind]
    try:
        return msgspec.json.decode(texts[-1], type=dict[str, Any]) if texts else {}
    except (msgspec.DecodeError, RecursionError):
        raise unusable(raw, f"holds a configuration of the {kind} that cannot be read") from None


def increasing(time_ns: FloatArray) -> IndexArray:
    """Rows whose time is known and later than that of every row before."""
    rows = np.flatnonzero(np.isfinite(time_ns))
    known = time_ns[rows]
    latest = np.maximum.accumulate(np.concatenate(([-np.inf], known[:-1])))
    return rows[known > latest]


def unusable(raw: RawRun, what: str) -> InputError:
    """A native run that cannot be used, with the remedy."""
    return InputError(raw.name, what, "record for longer" if raw.complete else "the file is cut off; record again")
