"""NumPy, JSON and HDF5 files as columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from daq import InputError, read_bytes
from experiments.exchange.imported import ImportedFile, by_length, needs
from experiments.exchange.tree import columns_of

MOST_BYTES = 1 << 29
"""Of one dataset, which can be declared and not be there."""


def read_numpy(path: Path) -> ImportedFile:
    """Columns of an .npz or .npy file without pickled objects. Raises what NumPy raises."""
    found = np.load(path, allow_pickle=False)
    return _imported(path, {"column": found} if isinstance(found, np.ndarray) else
                     {name: found[name] for name in found.files})


def read_json(path: Path) -> ImportedFile:
    """Columns of a JSON file, and what a recording of BAM says of its servo and its load next to its entries."""
    content = json.loads(read_bytes(path))
    keys = {"mass": "mass", "length": "length", "arm-mass": "arm", "arm_mass": "arm", "kp": "kp", "motor": "motor"}
    facts = {}
    if isinstance(content, dict) and isinstance(content.get("entries"), list):
        facts = {f"bam.{own}": str(content[key])[:40] for key, own in keys.items()
                 if isinstance(content.get(key), int | float | str)}
    return _imported(path, content, facts)


def read_hdf5(path: Path) -> ImportedFile:
    """Columns of an HDF5 file, each dataset once. Soft links are not followed: what they lead to is read at its own
    place. Raises `InputError` without h5py and for what is kept in another file."""
    try:
        import h5py  # type: ignore[import-untyped,import-not-found,unused-ignore]
    except ImportError:
        raise needs(path, "h5py", "hdf5") from None
    found: dict[str, Any] = {}
    outside: list[bytes] = []

    def refuse(name: str) -> NoReturn:
        raise InputError(f"{path}, {name}", "is kept in another file", "copy it into this file, as h5repack does")

    def take(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or "/#" in name:
            return
        if item.external or item.is_virtual:
            refuse(item.name)
        if item.size and item.size * max(item.dtype.itemsize, 1) > MOST_BYTES:
            raise InputError(f"{path}, {item.name}", f"declares {item.size:.3g} values", "give a smaller part of it")
        found[name] = item[()]

    with h5py.File(path, "r") as file:
        file.id.links.visit(lambda name, link: outside.append(name) if link.type == h5py.h5l.TYPE_EXTERNAL else None,
                            info=True)
        for name in outside:
            refuse(f"/{name.decode(errors='replace')}")
        file.visititems(take)
    return _imported(path, found, joint="/")


def _imported(path: Path, content: Any, facts: dict[str, str] | None = None, joint: str = ".") -> ImportedFile:
    columns, left_out = columns_of(content, joint=joint)
    return ImportedFile(path.name, by_length(columns), facts or {}, left_out)
