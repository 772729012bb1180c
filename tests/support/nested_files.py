"""One run as cells, structs, groups and archives hold it."""

import json
import pickle
import sys
import zipfile
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.io import savemat

Columns = Mapping[str, np.ndarray]
Maker = Callable[[Columns, Path], None]


def cells(*values: np.ndarray) -> np.ndarray:
    """(1, n) cell array."""
    out = np.empty((1, len(values)), dtype=object)
    out[0] = values if len({v.size for v in values}) > 1 else [*values]
    return out


def structs(columns: Columns, path: Path) -> None:
    savemat(path, {"log": {"time": columns["t"], "state": {"q": np.column_stack([columns["a"], columns["b"]])}}})


def npz(columns: Columns, path: Path) -> None:
    np.savez(path, **dict(columns))  # type: ignore[arg-type]


def records(columns: Columns, path: Path) -> None:
    path.write_text(json.dumps({"meta": "x", "entries": rows(columns)}))


def rows(columns: Columns) -> list[dict[str, float]]:
    return [dict(zip(columns, map(float, row))) for row in zip(*columns.values())]


def pickled(columns: Columns, path: Path) -> None:
    path.write_bytes(pickle.dumps({"log": dict(columns), "rows": rows(columns)}))


class _Storage:
    def __init__(self, kind: Any, key: str, count: int) -> None:
        self.kind, self.key, self.count = kind, key, count


def torch_archive(columns: Columns, path: Path) -> None:
    """As torch.save writes a mapping of float32 tensors: a zip of a pickle and the storages."""
    module, utils = ModuleType("torch"), ModuleType("torch._utils")
    kind = type("FloatStorage", (), {"__module__": "torch"})
    def _rebuild_tensor_v2(*parts: Any) -> None: ...
    _rebuild_tensor_v2.__module__, _rebuild_tensor_v2.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    module.FloatStorage, utils._rebuild_tensor_v2 = kind, _rebuild_tensor_v2  # type: ignore[attr-defined]

    class Tensor:
        def __init__(self, key: str, values: np.ndarray) -> None:
            self.parts: tuple[Any, ...] = _Storage(kind, key, values.size), 0, values.shape, \
                tuple(s // values.itemsize for s in np.ascontiguousarray(values).strides), False, {}

        def __reduce__(self) -> tuple[Any, ...]:
            return _rebuild_tensor_v2, self.parts

    class Pickler(pickle.Pickler):
        def persistent_id(self, item: Any) -> Any:
            return ("storage", item.kind, item.key, "cpu", item.count) if isinstance(item, _Storage) else None

    was = {name: sys.modules.get(name) for name in ("torch", "torch._utils")}
    sys.modules |= {"torch": module, "torch._utils": utils}
    try:
        buffer = BytesIO()
        Pickler(buffer, 2).dump({name: Tensor(str(k), v) for k, (name, v) in enumerate(columns.items())})
    finally:
        for name, old in was.items():
            sys.modules.pop(name)
            if old is not None:
                sys.modules[name] = old
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", buffer.getvalue())
        archive.writestr("log/byteorder", "little")
        for k, values in enumerate(columns.values()):
            archive.writestr(f"log/data/{k}", values.astype("<f4").tobytes())
