"""NumPy, JSON and HDF5 files as columns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from daq import InputError, read_bytes
from experiments.exchange.imported import ImportedFile, by_length
from experiments.exchange.tree import columns_of

MOST_PARTS, DEEPEST = 100_000, 64
"""Arrays, groups and datasets in one file, and groups within each other."""
MOST_BYTES = 1 << 29
"""Of one dataset, which can be declared and not be there."""


def read_numpy(path: Path) -> ImportedFile:
    """Columns of an .npz or .npy file without pickled objects. Raises what NumPy raises."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return _imported(path, {"column": found})
    if len(found.files) > MOST_PARTS:
        raise ValueError(f"more than {MOST_PARTS} arrays")
    return _imported(path, {name: found[name] for name in found.files})


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
        raise InputError(str(path), "needs the package h5py", 'install it: pip install "legid[hdf5]"') from None
    seen: set[int] = set()

    def refuse(name: str) -> NoReturn:
        raise InputError(f"{path}, {name}", "is kept in another file", "copy it into this file, as h5repack does")

    def content(item: Any, depth: int) -> Any:
        known = h5py.h5o.get_info(item.id).addr
        if known in seen:
            return None
        seen.add(known)
        if len(seen) > MOST_PARTS or depth > DEEPEST:
            raise ValueError(f"more than {MOST_PARTS} parts, or {DEEPEST} levels")
        if isinstance(item, h5py.Group):
            return {name: content(item[name], depth + 1) for name in item if not name.startswith("#")
                    and inside(item, name)}
        return dataset(item) if isinstance(item, h5py.Dataset) else None

    def inside(group: Any, name: str) -> bool:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            refuse(f"{group.name.rstrip('/')}/{name}")
        return isinstance(link, h5py.HardLink)

    def dataset(item: Any) -> Any:
        if item.external or item.is_virtual:
            refuse(item.name)
        if item.size and item.size * max(item.dtype.itemsize, 1) > MOST_BYTES:
            raise InputError(f"{path}, {item.name}", f"declares {item.size:.3g} values", "give a smaller part of it")
        return item[()]

    with h5py.File(path, "r") as file:
        return _imported(path, content(file, 0), joint="/")


def _imported(path: Path, content: Any, facts: dict[str, str] | None = None, joint: str = ".") -> ImportedFile:
    columns, left_out = columns_of(content, joint=joint)
    return ImportedFile(path.name, by_length(columns), facts or {}, left_out)
