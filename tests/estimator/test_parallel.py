"""Work on several processes."""

import os

import pytest

from estimator import FitError, cores
from estimator.parallel import parallel_map


def test_results_come_in_order_from_other_processes() -> None:
    base = 100
    found = parallel_map(lambda i: (base + i, os.getpid()), 5, 2)
    assert [value for value, _ in found] == [100, 101, 102, 103, 104]
    assert os.getpid() not in {pid for _, pid in found}


@pytest.mark.parametrize("count, workers", [(3, 1), (1, 4), (0, 2)])
def test_one_worker_or_one_piece_needs_no_process(count: int, workers: int) -> None:
    assert parallel_map(lambda i: os.getpid(), count, workers) == [os.getpid()] * count


def test_work_within_work_stays_in_its_process() -> None:
    inner = parallel_map(lambda i: parallel_map(lambda j: os.getpid(), 2, 2), 2, 2)
    assert all(len(set(pids)) == 1 for pids in inner)


def test_what_the_work_raises_is_raised_and_the_next_work_starts_afresh() -> None:
    def fails(i: int) -> int:
        raise FitError(f"piece {i}")

    with pytest.raises(FitError, match="piece 0"):
        parallel_map(fails, 2, 2)
    assert parallel_map(lambda i: i, 2, 2) == [0, 1]


def test_a_killed_process_costs_time_only() -> None:
    here = os.getpid()

    def dies(i: int) -> int:
        if os.getpid() != here:
            os._exit(9)
        return i

    assert parallel_map(dies, 3, 2) == [0, 1, 2]


def test_there_is_a_core() -> None:
    assert cores() >= 1
