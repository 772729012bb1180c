"""The machine that a figure was measured on, in one line."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

from estimator import cores


def machine() -> str:
    """Cores that this process may use, processor, system, and the versions that decide the speed of arrays."""
    count = cores()
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy"))
    return (f"{count} core{'s' if count != 1 else ''}, {_processor()}, {platform.system()}, "
            f"Python {platform.python_version()}, {packages}")


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()
