"""`Kernel`: a function on arrays made machine code by Numba once on a machine, and loaded without Numba after that.

Numba with its caches takes half a second to load what it compiled; the object code alone, handed to LLVM's linker,
takes hundredths. So a kernel is compiled through Numba when nobody has it yet, its object code is kept in `folder()`
under a digest of all that it depends on, and every later process loads that.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np

at = np.uint64
"""A sum of indices as the compiler needs it to know that it does not count from an array's end."""
FORMAT = 1
"""Of what is kept; another one leaves older files alone."""
HOME_VARIABLE = "NUMBA_CACHE_DIR"
HEADER = object.__basicsize__ // 8
"""Words of a Python object's header; numpy's array has its data there, its shape two words further (its C interface,
`PyArrayObject_fields`)."""
ARRAYS = {"f": np.dtype(np.float64), "i": np.dtype(np.int64)}
LOCK = RLock()
SCALARS: dict[str, Any] = {"d": ctypes.c_double, "n": ctypes.c_int64}


class Kernel:
    """`function` as machine code, compiled or loaded when first called.

    `kinds` has a word an argument: "f3" an array of float64 with three axes, "i1" one of int64 with one, "d" a float,
    "n" an integer. Arrays are contiguous; anything else is a TypeError. The function returns nothing and makes no
    arrays: what it needs for itself it is given. `exact` keeps sums in the order in which they are written.
    """

    def __init__(self, function: Callable[..., None], kinds: str, exact: bool = False) -> None:
        self.function, self.kinds, self.exact = function, kinds.split(), exact
        self._checks = [(i, ARRAYS[kind[0]], int(kind[1])) for i, kind in enumerate(self.kinds) if kind[0] in ARRAYS]
        self._entry: Callable[..., None] | None = None

    def __call__(self, *args: Any) -> None:
        for i, kind, axes in self._checks:
            a = args[i]
            if a.dtype != kind or a.ndim != axes or not a.flags.c_contiguous:
                raise TypeError(f"argument {i} of {self.function.__qualname__}: {a.dtype} {a.shape}, not "
                                f"{self.kinds[i]} without gaps")
        (self._entry or self.load())(*args)

    def load(self) -> Callable[..., None]:
        """Its entry, after compiling it where nobody has."""
        with LOCK:
            if self._entry is not None:
                return self._entry
            name = f"{self.function.__qualname__.split('.')[0].strip('_')}_{self._digest()}"
            path = folder() / f"{name}.o"
            code = _read(path)
            if code is None:
                code = _compile(self.function, self.kinds, self.exact, name)
                _keep(path, code)
            linker = _linker()
            linker.add_object_file(_llvm().ObjectFileRef.from_data(code))
            linker.finalize_object()
            types = [ctypes.py_object if kind[0] in ARRAYS else SCALARS[kind] for kind in self.kinds]
            self._entry = ctypes.CFUNCTYPE(None, *types)(linker.get_function_address(name))
            return self._entry

    def _digest(self) -> str:
        """Of all that the machine code depends on."""
        code, function = self.function.__code__, self.function
        inner = [cell.cell_contents for cell in function.__closure__ or ()]
        outer = [(name, function.__globals__[name]) for name in code.co_names if name in function.__globals__
                 and isinstance(function.__globals__[name], (int, float, tuple))]
        llvm = _llvm()
        parts = (FORMAT, HEADER, _source(function.__module__), function.__qualname__, code.co_firstlineno, inner, outer,
                 self.kinds, self.exact, sys.modules["llvmlite"].__version__, llvm.get_process_triple(),
                 llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def folder() -> Path:
    """Folder of compiled kernels: $NUMBA_CACHE_DIR, or legid in the user's cache."""
    chosen = os.environ.get(HOME_VARIABLE)
    if chosen:
        return Path(chosen)
    cache_home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache_home) / "legid"


@cache
def _llvm() -> Any:
    """LLVM's binding, ready for this machine."""
    from llvmlite import binding  # none of it for commands that fit nothing

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


def _machine() -> Any:
    llvm = _llvm()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3, jit=True)


@cache
def _linker() -> Any:
    """What links all kernels of this process."""
    return _llvm().create_mcjit_compiler(_llvm().parse_assembly(""), _machine())


@cache
def _source(module: str) -> str:
    return Path(str(sys.modules[module].__file__)).read_text(encoding="utf-8")


def _read(path: Path) -> bytes | None:
    """Object code that was kept, None where there is none or it is not what was written."""
    try:
        kept = path.read_bytes()
    except OSError:
        return None
    return kept[32:] if hashlib.sha256(kept[32:]).digest() == kept[:32] else None


def _keep(path: Path, code: bytes) -> None:
    """For the next process, at once or not at all; where nothing can be written that process compiles again."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:  # which a full disk leaves nothing of
            with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(file.name, path)


def _compile(function: Callable[..., None], kinds: list[str], exact: bool, name: str) -> bytes:
    """Object code that has `name` for its only symbol, and needs nothing of Numba's at run time."""
    import numba
    from numba import types
    from numba.core import extending

    carray: Any = getattr(numba, "carray")  # noqa: B009, it is not declared
    pointer: Any = types.CPointer

    @extending.intrinsic
    def doubles(_: Any, words: Any) -> Any:
        """The same address, of floats."""
        to = pointer(types.float64)

        def turn(context: Any, builder: Any, __: Any, args: Any) -> Any:
            return builder.bitcast(args[0], context.get_value_type(to))

        return to(words), turn

    loose = {"contract", "nsz"} if exact else {"contract", "reassoc", "nsz"}
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": loose}
    words = pointer(pointer(types.int64))
    passed = {"f": words, "i": words, "d": types.float64, "n": types.int64}
    values = []
    for i, kind in enumerate(kinds):
        shape = "".join(f"p{i}[{HEADER + 2}][{axis}], " for axis in range(int(kind[1:] or 0)))
        data = {"f": f"doubles(p{i}[{HEADER}])", "i": f"p{i}[{HEADER}]"}.get(kind[0])
        values.append(f"p{i}" if data is None else f"carray({data}, ({shape}))")
    names = ", ".join(f"p{i}" for i in range(len(kinds)))
    scope = {"kernel": numba.njit(inline="always", **options)(function), "carray": carray, "doubles": doubles}
    exec(f"def entry({names}):\n    kernel({', '.join(values)})", scope)
    entry = numba.cfunc(types.void(*(passed[kind[0]] for kind in kinds)), **options)(scope["entry"])
    llvm, machine = _llvm(), _machine()
    module = llvm.parse_assembly(entry.inspect_llvm())
    for part in (*module.functions, *module.global_variables):
        if not part.is_declaration:
            part.linkage = "internal"
    main = module.get_function(entry.native_name)
    main.linkage = "external"
    main.name = name
    passes = llvm.create_new_module_pass_manager()
    passes.add_ipsccp_pass()  # a kernel that cannot fail leaves nothing of the ways to say so
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3)))
    strange = [f.name for f in module.functions if f.is_declaration and f.name.startswith(("numba_", "NRT_", "Py"))]
    if strange:
        raise TypeError(f"{function.__qualname__} needs {', '.join(strange)}: it makes arrays or may fail")
    return bytes(machine.emit_object(module))


def expect() -> None:
    """Get LLVM's linker now: much work is to come, perhaps in processes forked from this one."""
    _linker()
