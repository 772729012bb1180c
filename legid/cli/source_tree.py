"""Parts of the source tree that are not in the installed package: the studies."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[2]


def study(name: str) -> Callable[[argparse.Namespace], int]:
    """The function `run` of `studies/NAME.py`. Raises `WorkError` where legid is installed without its source tree."""
    if not (ROOT / "studies" / f"{name}.py").is_file():
        from daq import WorkError

        raise WorkError("the studies are in legid's source tree, not in the installed package; clone the repository, "
                        "and run the command there: python -m legid.cli")
    if str(ROOT) not in sys.path:  # an editable installation knows the packages of the wheel alone
        sys.path.append(str(ROOT))
    run: Callable[[argparse.Namespace], int] = import_module(f"studies.{name}").run
    return run
