"""NumPy, PyTorch, pickle, JSON and HDF5 files as columns. Nothing that a file names is run.

A pickle is a program. Here its machine has no functions but the classes of this module, which keep what they are given;
any other class that it names becomes `_Inert`, which keeps nothing. PyTorch is not needed: a `.pt` is a zip file of one
pickle and the numbers of each tensor.
"""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from daq import InputError, read_bytes
from experiments.exchange.imported import ImportedFile, by_length
from experiments.exchange.nested import vectors

SUFFIXES = (".npz", ".npy", ".pt", ".pth", ".pkl", ".pickle", ".json", ".h5", ".hdf5")
MOST_PARTS, DEEPEST = 100_000, 64
"""Containers in one file, and within each other; a pickle of a hundred bytes can hold more."""
MOST_BYTES = 1 << 29
"""Of one dataset, which can be declared and not be there."""
STORAGES = {"DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
            "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "?"}
"""PyTorch's names of the kinds of numbers."""


def read_archive(path: Path) -> ImportedFile:
    """Vectors of a file that its name's ending says the kind of, called as in `nested`. Raises `InputError`, and what
    the kind's library raises."""
    name = path.name.lower()
    read, joint = next((how for suffixes, how in _READERS if name.endswith(suffixes)), (_json, "."))
    try:
        content = read(path)
        columns = dict(vectors(content, joint=joint))
    except ImportError:
        raise InputError(str(path), "needs the package h5py", 'install it: pip install "legid[hdf5]"') from None
    return ImportedFile(path.name, by_length(columns), _pendulum(content))


def _pendulum(content: Any) -> dict[str, str]:
    """What a recording of BAM says of its servo and its load next to its entries; empty for other files."""
    if not isinstance(content, dict) or not isinstance(content.get("entries"), list):
        return {}
    keys = {"mass": "mass", "length": "length", "arm-mass": "arm", "arm_mass": "arm", "kp": "kp", "motor": "motor"}
    return {f"bam.{own}": str(content[key])[:40] for key, own in keys.items()
            if isinstance(content.get(key), int | float | str)}


def _numpy(path: Path) -> Any:
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return {"column": found}
    if len(found.files) > MOST_PARTS:
        raise ValueError(f"more than {MOST_PARTS} arrays")
    return {name: found[name] for name in found.files}


def _json(path: Path) -> Any:
    return json.loads(read_bytes(path))


def _pickle(path: Path) -> Any:
    return _plain(_Machine(io.BytesIO(read_bytes(path)), {}).load())


def _torch(path: Path) -> Any:
    with zipfile.ZipFile(path) as archive:
        inside = next(name for name in archive.namelist() if name.endswith("data.pkl"))
        folder = inside.removesuffix("data.pkl")
        big = f"{folder}byteorder" in archive.namelist() and archive.read(f"{folder}byteorder") == b"big"
        numbers = {name.removeprefix(f"{folder}data/"): archive.read(name) for name in archive.namelist()
                   if name.startswith(f"{folder}data/")}
        return _plain(_Machine(io.BytesIO(archive.read(inside)), numbers, big).load())


def _hdf5(path: Path) -> Any:
    """Groups and datasets, each once. Soft links are not followed: what they lead to is read at its own place."""
    import h5py  # type: ignore[import-untyped,import-not-found,unused-ignore]

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
        return dataset(item, depth) if isinstance(item, h5py.Dataset) else None

    def inside(group: Any, name: str) -> bool:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            refuse(f"{group.name.rstrip('/')}/{name}")
        return isinstance(link, h5py.HardLink)

    def dataset(item: Any, depth: int) -> Any:
        if item.external or item.is_virtual:
            refuse(item.name)
        if item.size and item.size * max(item.dtype.itemsize, 1) > MOST_BYTES:
            raise InputError(f"{path}, {item.name}", f"declares {item.size:.3g} values", "give a smaller part of it")
        values = item[()]
        if isinstance(values, np.ndarray) and values.dtype == h5py.ref_dtype:
            return [content(file[one], depth + 1) for one in values.ravel() if one]  # cells, as MATLAB 7.3 keeps them
        return values

    with h5py.File(path, "r") as file:
        return content(file, 0)


class _Inert:
    """An object of a class that is not read."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        pass

    def __setitem__(self, key: Any, value: Any) -> None:
        pass

    def append(self, item: Any) -> None:
        """Keeps nothing, as `extend`."""

    def extend(self, items: Any) -> None:
        """Keeps nothing."""


class _Dtype:
    """numpy.dtype of plain numbers."""

    def __init__(self, code: str = "f8", *_: Any) -> None:
        self.code, self.big = str(code), False

    def __setstate__(self, state: Any) -> None:
        self.big = state[1] == ">"

    @property
    def plain(self) -> np.dtype[Any]:
        found = np.dtype(self.code)
        if found.kind not in "fiub":
            raise ValueError(f"an array of {self.code} holds no plain numbers")
        return found.newbyteorder(">" if self.big else "<")


class _Array:
    """numpy.ndarray."""

    def __init__(self, *_: Any) -> None:
        self.state: Any = (1, (0,), _Dtype(), False, b"")

    def __setstate__(self, state: Any) -> None:
        self.state = state

    @property
    def plain(self) -> Any:
        _, shape, kind, fortran, data = self.state
        if isinstance(data, list):  # of objects
            return data
        return np.frombuffer(_bytes(data), kind.plain).reshape(shape, order="F" if fortran else "C")


def _from_buffer(data: Any, kind: _Dtype, shape: Any, order: str = "C") -> _Array:
    array = _Array()
    array.state = (1, shape, kind, order == "F", _bytes(data))
    return array


def _scalar(kind: _Dtype, data: Any = b"") -> Any:
    return np.frombuffer(_bytes(data), kind.plain)[0].item()


def _bytes(data: Any) -> bytes:
    if isinstance(data, str):
        return data.encode("latin1")
    if not isinstance(data, bytes | bytearray):  # a number would be a count of zeros
        raise ValueError("an array without its bytes")
    return bytes(data)


def _encode(text: str, code: str = "latin1") -> bytes:
    return text.encode("latin1")


def _tensor(storage: Any, offset: int, size: Any, stride: Any, *_: Any) -> np.ndarray:
    """(size) of a storage's numbers; NumPy refuses what does not lie within."""
    width = storage.itemsize
    if prod(size) > storage.size:
        raise ValueError("a tensor of more numbers than it holds")
    return np.ndarray(tuple(size), storage.dtype, storage.data, offset * width, [s * width for s in stride])


_SAFE: dict[str, Callable[..., Any]] = {
    "collections.OrderedDict": dict, "_codecs.encode": _encode, "torch._utils._rebuild_tensor_v2": _tensor,
    "torch._utils._rebuild_parameter": lambda data, *_: data, "numpy.dtype": _Dtype, "numpy.ndarray": _Array,
    **{f"numpy.{core}.multiarray.{name}": made for core in ("core", "_core")
       for name, made in (("_reconstruct", _Array), ("scalar", _scalar))},
    **{f"numpy.{core}.numeric._frombuffer": _from_buffer for core in ("core", "_core")}}


class _Machine(pickle.Unpickler):
    """Runs a pickle with `_SAFE` in place of everything that it names."""

    def __init__(self, file: io.BytesIO, numbers: dict[str, bytes], big: bool = False) -> None:
        super().__init__(file, encoding="latin1")
        self._numbers, self._big = numbers, big

    def find_class(self, module: str, name: str) -> Any:
        """Substitute of `module.name`."""
        if module in ("torch", "torch.storage") and name in STORAGES:
            return STORAGES[name]
        return _SAFE.get(f"{module}.{name}", _Inert)

    def persistent_load(self, place: Any) -> Any:
        """(n,) numbers of a tensor's storage."""
        _, code, key, *_ = place
        if not isinstance(code, str):
            raise ValueError("a tensor of numbers of a kind that is not known")
        return np.frombuffer(self._numbers[str(key)], np.dtype(code).newbyteorder(">" if self._big else "<"))


def _plain(value: Any) -> Any:
    """`value` of mappings, lists and arrays alone."""
    left = MOST_PARTS

    def walk(item: Any, depth: int = 0) -> Any:
        nonlocal left
        if isinstance(item, int | float | str | bytes | np.ndarray | None):
            return item
        left -= 1
        if left < 0 or depth > DEEPEST:
            raise ValueError(f"more than {MOST_PARTS} parts, or {DEEPEST} levels")
        if isinstance(item, _Array):
            return walk(item.plain, depth + 1)
        if isinstance(item, dict):
            return {key: walk(inner, depth + 1) for key, inner in item.items()}
        return [walk(inner, depth + 1) for inner in item] if isinstance(item, list | tuple) else None

    return walk(value)


_READERS: tuple[tuple[tuple[str, ...], tuple[Callable[[Path], Any], str]], ...] = (
    ((".npz", ".npy"), (_numpy, ".")), ((".pt", ".pth"), (_torch, ".")), ((".pkl", ".pickle"), (_pickle, ".")),
    ((".h5", ".hdf5", ".mat"), (_hdf5, "/")))
