"""Executors: local processes, and a real Dask scheduler whose worker is killed half way."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daq import InputError, WorkError
from evidence.blind.stickslip import MAKERS
from experiments.workflows import choose_executor
from experiments.workflows.executor import ClusterExecutor, LocalExecutor, SerialExecutor
from studies.biped3 import CASES, FLOOR, blocks
from studies.biped3.store import load_block
from studies.biped3.study import run_block
from tests.support.changed_leg import leg_runs
from tests.support.paths import ROOT
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Shell, document

pytestmark = REAL_CLOCK


def square(x: int) -> int:
    return x * x


def slow_square(x: int) -> int:
    time.sleep(0.15)
    return x * x


def threads(_: int) -> str:
    return os.environ.get("OMP_NUM_THREADS", "")


def refuse(x: int) -> int:
    raise InputError(f"run {x}", "is empty", "record it again")


def die(x: int) -> int:
    if x == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def test_serial_and_local_give_every_piece_its_result() -> None:
    for executor in (SerialExecutor(), LocalExecutor(2)):
        assert dict(executor.run(square, [3, 4, 5])) == {0: 9, 1: 16, 2: 25}


def test_local_workers_use_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert dict(LocalExecutor(2).run(threads, [0, 1])) == {0: "1", 1: "1"}
    assert "OMP_NUM_THREADS" not in os.environ


def test_a_refusal_by_a_local_worker_is_said_as_it_is() -> None:
    with pytest.raises(InputError, match=r"^run 1: is empty; record it again$"):
        list(LocalExecutor(2).run(refuse, [1]))


def test_a_dead_local_worker_is_said_in_one_line() -> None:
    with pytest.raises(WorkError, match="worker process died"):
        list(LocalExecutor(2).run(die, [1, 2, 3]))


def test_choice() -> None:
    assert isinstance(choose_executor(1, None), SerialExecutor)
    assert choose_executor(3, None) == LocalExecutor(3)
    assert choose_executor(None, "tcp://h:1") == ClusterExecutor("tcp://h:1")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A scheduler and two worker processes of their own."""
    pytest.importorskip("distributed", reason="the cluster extra is not installed")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    info = tmp_path / "scheduler.json"
    running = []

    def launch(*arguments: str) -> None:
        running.append(subprocess.Popen([sys.executable, "-m", *arguments], env=environment, cwd=tmp_path,
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    try:
        launch("distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(info))
        for _ in range(2):
            launch("distributed.cli.dask_worker", "--scheduler-file", str(info), "--no-nanny", "--nthreads", "1",
                   "--no-dashboard", "--local-directory", str(tmp_path))
        from distributed import Client

        with Client(scheduler_file=str(info), timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
            address = client.scheduler.address
        yield address, running
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait(timeout=30)


@pytest.mark.slow
def test_cluster_loses_nothing_when_a_worker_is_killed(cluster: tuple[str, list[subprocess.Popen]]) -> None:
    address, processes = cluster
    pieces = list(range(40))
    found = {}
    for index, result in ClusterExecutor(address).run(slow_square, pieces):
        found[index] = result
        if len(found) == 12:
            processes[1].send_signal(signal.SIGKILL)
            processes[1].wait(timeout=30)
    assert found == {k: k * k for k in pieces}
    assert processes[1].returncode == -signal.SIGKILL
    assert processes[2].poll() is None


@pytest.mark.slow
def test_a_study_on_a_cluster_survives_a_killed_worker(cluster: tuple[str, list[subprocess.Popen]],
                                                       here: Path, shell: Shell) -> None:
    """Through the command; the killed worker's blocks are done by the other, with the numbers of a run without both."""
    address, processes = cluster
    work = blocks(CASES[1:2], ["mle", FLOOR], 250, 6)
    kept = here / "study/blocks"

    def kill_half_way() -> None:
        while len(list(kept.glob("*.npz"))) < len(work) // 3:
            time.sleep(0.005)
        processes[1].send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill_half_way)
    killer.start()
    shell("monte-carlo biped3 --runs 250 --cases 2 --methods mle --seed 6 --cluster", address, "--out study")
    killer.join(timeout=30)
    assert processes[1].wait(timeout=30) == -signal.SIGKILL
    assert processes[2].poll() is None
    for block in work:
        assert load_block(kept, block) is not None
    for block in (work[0], work[-1]):
        found, alone = load_block(kept, block), run_block(block)
        np.testing.assert_allclose(found.beta, alone.beta, rtol=1e-9)
        np.testing.assert_allclose(found.error, alone.error, rtol=1e-6)


@pytest.mark.slow
def test_sessions_are_compared_on_a_cluster_as_in_one_process(cluster: tuple[str, list[subprocess.Popen]],
                                                              tmp_path: Path) -> None:
    """Three sessions; the torque of the last one is late."""
    files, rig = leg_runs(tmp_path, MAKERS["torque_delay"][0](1.0))
    words = "compare", *files[:2], "--with", *files[2:4], "--with", *files[4:6], "--rig", rig
    found = [[pair | {"wall_s": 0.0} for pair in document(*words, where)["pairs"]]
             for where in (f"--cluster {cluster[0]}", "--workers 1")]
    assert found[0] == found[1]
    assert [pair["b"]["name"] for pair in found[0]] == ["B", "C"]
    assert "torque_delay" in {cause["effect"] for cause in found[0][1]["causes"]}


def test_a_scheduler_that_does_not_answer_is_said_in_one_line() -> None:
    pytest.importorskip("distributed", reason="the cluster extra is not installed")
    with pytest.raises(InputError, match="no scheduler answers"):
        list(ClusterExecutor("tcp://127.0.0.1:9", timeout_s=1.0).run(square, [1]))
