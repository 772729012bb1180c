"""Results of a study on disk: one small file a block, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path

import numpy as np

from daq import InputError, write_file
from experiments.console import make_directory
from experiments.workflows import Executor
from studies.biped3.study import Block, BlockResult, run_block

FIELDS = ("beta", "std", "error", "converged", "failed", "likelihood_ratio")
STUDY_CODE = ("rk4_free_run.py", "walker.py", "biped3/study.py", "biped3/protocol.py", "biped3/likelihood.py")


@lru_cache(maxsize=1)
def program() -> str:
    """Fingerprint of the code that makes results: those of other code are done again, never mixed in."""
    sources = [*sorted(Path(str(files("estimator"))).rglob("*.py")),
               *(Path(str(files("studies"))) / name for name in STUDY_CODE)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]


def save_block(folder: Path, block: Block, result: BlockResult) -> None:
    """Write whole or not at all."""
    path = folder / f"{block.name}.npz"
    out = BytesIO()
    np.savez(out, program=program(), seconds=result.seconds, **{name: getattr(result, name) for name in FIELDS})
    write_file(path, out.getvalue(), changed=True)


def load_block(folder: Path, block: Block) -> BlockResult | None:
    """None where the block has not been done, or by other code."""
    path = folder / f"{block.name}.npz"
    try:
        with np.load(path) as file:
            if str(file["program"]) != program():
                return None
            return BlockResult(**{name: file[name] for name in FIELDS}, seconds=float(file["seconds"]))
    except (FileNotFoundError, zipfile.BadZipFile, KeyError, ValueError, EOFError):
        return None


def run_study(work: Sequence[Block], folder: Path, executor: Executor,
              done: Callable[[Block, int], None]) -> dict[Block, BlockResult]:
    """All blocks, those on disk from there; `done(block, runs)` is called for each, finished or found.

    Raises `InputError` where `folder` cannot be written, `WorkError` where the executor is lost; what was finished
    by then stays.
    """
    make_directory(folder)
    results: dict[Block, BlockResult] = {}
    missing = []
    for block in work:
        found = load_block(folder, block)
        if found is None:
            missing.append(block)
        else:
            results[block] = found
            done(block, block.count)
    for index, result in executor.run(run_block, missing):
        block = missing[index]
        save_block(folder, block, result)
        results[block] = result
        done(block, block.count)
    return results


def require_parquet() -> None:
    """Raises `InputError` where pyarrow is missing: better before a long study than after it."""
    from importlib.util import find_spec

    if find_spec("pyarrow") is None:
        raise InputError("runs.parquet", "writing Parquet needs pyarrow", "pip install 'legid[parquet]'")


def write_parquet(path: Path, results: dict[Block, BlockResult], names: Sequence[str]) -> None:
    """One row a run: case, method, run, estimates and their standard deviations, error, verdict.

    Raises `InputError` where `path` cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    ordered = sorted(results.items(), key=lambda item: (item[0].case.number, item[0].method, item[0].first))
    columns: dict[str, object] = {
        "case": np.concatenate([np.full(b.count, b.case.number, dtype=np.int8) for b, _ in ordered]),
        "method": [b.method for b, _ in ordered for _ in range(b.count)],
        "run": np.concatenate([np.arange(b.first, b.first + b.count, dtype=np.int32) for b, _ in ordered]),
        "seed": np.concatenate([np.full(b.count, b.seed, dtype=np.int64) for b, _ in ordered])}
    for k, name in enumerate(names):
        columns[name] = np.concatenate([r.beta[:, k] for _, r in ordered])
        columns[f"{name}_std"] = np.concatenate([r.std[:, k] for _, r in ordered])
    columns["summed_squared_error_rad2"] = np.concatenate([r.error for _, r in ordered])
    columns["converged"] = np.concatenate([r.converged for _, r in ordered])
    columns["failed"] = np.concatenate([r.failed for _, r in ordered])
    columns["likelihood_ratio"] = np.concatenate([r.likelihood_ratio for _, r in ordered])
    out = BytesIO()
    parquet.write_table(pa.table(columns), out, compression="zstd")
    write_file(path, out.getvalue())
