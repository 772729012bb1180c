"""Execution of independent pieces of work: this process, local processes, or a Dask cluster that is already there.

Every executor hands back (index, result) as pieces finish, in any order. A piece is a module-level function and
one picklable argument.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from daq import InputError, WorkError
from estimator import cores, worker_pool

T = TypeVar("T")
R = TypeVar("R")
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Workers are one a core, so each does its linear algebra on one thread."""
RETRIES = 5
"""Deaths of a worker that a piece of work on a cluster survives."""


class Executor(Protocol):
    """Runs pieces of work."""

    def run(self, function: Callable[[T], R], pieces: Sequence[T]) -> Iterator[tuple[int, R]]:
        """(index of the piece, result) as they finish. An error in a piece is raised here."""
        ...


class SerialExecutor:
    """One piece after the other in this process."""

    def run(self, function: Callable[[T], R], pieces: Sequence[T]) -> Iterator[tuple[int, R]]:
        yield from ((k, function(piece)) for k, piece in enumerate(pieces))


@dataclass(frozen=True)
class LocalExecutor:
    """Processes on this machine; they start fresh, so nothing of this process's state leaks into a result."""

    workers: int

    def run(self, function: Callable[[T], R], pieces: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Raises `WorkError` when a process dies."""
        try:
            with worker_pool(min(self.workers, max(len(pieces), 1)), "spawn", ONE_THREAD) as pool:
                futures = {pool.submit(function, piece): k for k, piece in enumerate(pieces)}
                for future in as_completed(futures):
                    yield futures[future], future.result()
        except BrokenProcessPool:
            raise WorkError("a worker process died (out of memory?); run again to go on from where it stopped, with "
                            "fewer --workers") from None


@dataclass(frozen=True)
class ClusterExecutor:
    """A Dask scheduler with workers that have this program installed; lost workers' pieces are done again."""

    address: str
    timeout_s: float = 10.0

    def run(self, function: Callable[[T], R], pieces: Sequence[T]) -> Iterator[tuple[int, R]]:
        """Raises `InputError` where the extra is missing or nobody answers, `WorkError` where the cluster is lost."""
        try:
            from importlib import import_module

            distributed: Any = import_module("distributed")
        except ImportError:
            raise InputError("--cluster", "needs the package distributed", "pip install 'legid[cluster]'") from None
        try:
            client: Any = distributed.Client(self.address, timeout=self.timeout_s, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            reason = str(error).split("\n")[0] or type(error).__name__
            raise InputError("--cluster", f"no scheduler answers at {self.address} ({reason})",
                             "give the address that dask scheduler printed, e.g. tcp://host:8786") from None
        with client:
            if not client.scheduler_info(n_workers=-1)["workers"]:
                raise WorkError(f"the cluster at {self.address} has no workers; start dask worker there")
            futures = [client.submit(function, piece, pure=False, retries=RETRIES) for piece in pieces]
            index = {future.key: k for k, future in enumerate(futures)}
            try:
                for future, result in distributed.as_completed(futures, loop=client.loop, with_results=True):
                    yield index[future.key], result
                    future.release()
            except distributed.KilledWorker as error:
                raise WorkError(f"workers of the cluster kept dying: {str(error).splitlines()[0]}") from None
            except (distributed.CancelledError, OSError):
                raise WorkError(f"the cluster at {self.address} was lost; run again to go on from there") from None
            finally:
                client.cancel(futures)


def choose_executor(workers: int | None, cluster: str | None) -> Executor:
    """Executor by `--workers` and `--cluster`; by default one process a core."""
    if cluster is not None:
        return ClusterExecutor(cluster)
    count = workers if workers is not None else cores()
    return LocalExecutor(count) if count > 1 else SerialExecutor()
