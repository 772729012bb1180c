"""The study: its data, its blocks, resuming, and its command."""

import itertools
import json
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import MonkeyPatch, approx, mark, raises

from estimator import fit
from estimator.fitting import design_rows
from estimator.signals import split_signals
from experiments.workflows.executor import SerialExecutor
from studies.biped3 import CASES, FLOOR, blocks, make_table, store, study, table_document
from studies.biped3.protocol import OURS, PRINTED, TORQUE_VARIANCE
from studies.biped3.study import (
    KNOWN_WLS,
    PAPERS_MLE,
    Block,
    case_options,
    error_of_truth,
    noisy_record,
    run_block,
    truth,
)
from studies.biped3.table import PAPER, bound
from studies.walker import motor_mechanism, one_step
from tests.support.shell import Shell


def test_noise_is_that_of_table_ii_and_depends_on_seed_case_and_run_alone() -> None:
    step = one_step().in_motor_angles()
    angle = np.concatenate([noisy_record(step, CASES[3], 5, k)["q1_rad"] - step.q[:, 0] for k in range(60)])
    torque = np.concatenate([noisy_record(step, CASES[3], 5, k)["tau3_nm"] - step.torque[:, 2] for k in range(60)])
    assert np.var(angle) == approx(1e-4, rel=0.06)
    assert np.var(torque) == approx(0.1, rel=0.06)
    first, again, other = (noisy_record(step, CASES[3], seed, 7)["q1_rad"] for seed in (5, 5, 6))
    assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert_array_equal(noisy_record(step, CASES[3], 5, 7)["q2_rad"], step.q[:, 1])


def test_blocks_cover_every_run_once() -> None:
    work = blocks(CASES[:2], ["mle", FLOOR], 120, 1)
    runs = {(b.case.number, b.method, k) for b in work for k in range(b.first, b.first + b.count)}
    assert len(runs) == sum(b.count for b in work) == 2 * 2 * 120


def test_floor_is_least_squares_on_the_truth() -> None:
    result = run_block(Block(CASES[0], FLOOR, 0, 50, 3))
    off = (result.beta - truth()) / result.std
    assert 0.8 < np.sqrt(np.mean(off**2)) < 1.2
    assert 0.002 < result.error.mean() < 0.02
    assert not result.failed.any()


def test_mle_is_near_its_bound_and_best_of_four() -> None:
    case = CASES[2]
    found = {m: run_block(Block(case, m, 0, 40, 3)) for m in ("mle", "wls", "rls", "hekf")}
    table = make_table({Block(case, m, 0, 40, 3): r for m, r in found.items()}, 3)
    mle = table.cell(3, "mle")
    assert mle.failed == 0 and mle.not_converged == 0
    assert mle.mean_mse_over_bound < 1.3
    assert 0.9 < mle.coverage < 0.99
    assert all(mle.mean < cell.mean for cell in table.cells if cell.method != "mle")


def test_bound_grows_with_noise() -> None:
    spread = [np.diag(bound(case)) for case in CASES]
    assert all(np.all(a <= b * (1 + 1e-9)) for a, b in itertools.pairwise(spread))


def test_an_interrupted_study_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    work = blocks(CASES[:1], [FLOOR], 150, 2)
    whole = store.run_study(work, tmp_path / "whole", SerialExecutor(), lambda block, count: None)
    asked: list[Block] = []

    def dies_after_two(block: Block) -> study.BlockResult:
        if len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(block)
        return run_block(block)

    monkeypatch.setattr(store, "run_block", dies_after_two)
    with raises(KeyboardInterrupt):
        store.run_study(work, tmp_path / "part", SerialExecutor(), lambda block, count: None)
    (tmp_path / "part" / f"{work[1].name}.npz").write_bytes(b"half a file")
    redone = []

    def counted(block: Block) -> study.BlockResult:
        redone.append(block)
        return run_block(block)

    monkeypatch.setattr(store, "run_block", counted)
    resumed = store.run_study(work, tmp_path / "part", SerialExecutor(), lambda block, count: None)
    assert redone == work[1:]
    for block in work:
        assert_array_equal(resumed[block].error, whole[block].error)


def test_command_writes_table_report_and_runs(tmp_path: Path, shell: Shell) -> None:
    out, js = tmp_path / "study", tmp_path / "table.json"
    arguments = "monte-carlo biped3 --runs 6 --cases 1 --methods mle,wls --workers 1 --out", out, "--json", js
    shell(*arguments)
    text = shell.out
    assert "MLE" in text and "1.242" in text and "floor" in text
    document = json.loads(js.read_text())
    assert document["schema"] == "legid.monte-carlo/1"
    row = next(r for r in document["results"] if r["method"] == "mle")
    assert row["runs"] == 6 and row["paper"]["mean"] == 1.242
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 1 and "1.242" in page and "--cases</span> 1" in page
    from pyarrow import parquet

    runs = parquet.read_table(out / "runs.parquet").to_pydict()
    assert len(runs["run"]) == 3 * 6
    assert {"beta1", "beta8_std", "summed_squared_error_rad2"} <= set(runs)


@mark.parametrize("arguments", [["--runs", "0"], ["--cases", "6"], ["--methods", "magic"],
                                       ["--workers", "2", "--cluster", "tcp://x:1"]])
def test_wrong_arguments_are_refused_in_one_line(arguments: list[str], shell: Shell) -> None:
    shell("monte-carlo biped3", *arguments, status=2)
    assert len(shell.err.strip().splitlines()) == 1


def test_paper_table_has_four_cases_by_method() -> None:
    assert {method: len(rows) for method, rows in PAPER.items()} == dict.fromkeys(
        ("mle", "wls", "hekf", "rls", PAPERS_MLE, KNOWN_WLS), 4)
    result = run_block(Block(CASES[0], FLOOR, 0, 5, 1))
    document = table_document(make_table({Block(CASES[0], FLOOR, 0, 5, 1): result}, 1), 1.0)
    assert document["cases"][0]["angle_variance"] == 1e-10


def test_the_printed_protocol_has_the_prints_floor_and_ours_has_none() -> None:
    assert error_of_truth(OURS) < 1e-9
    assert error_of_truth(PRINTED) == approx(PAPER["mle"][0][0], rel=0.05)


def test_under_the_printed_protocol_mle_errs_as_printed_and_rls_less_in_case_2() -> None:
    """The excess over the true parameters is nothing for MLE and negative for RLS, as in the print."""
    found = {m: run_block(Block(CASES[1], m, 0, 20, 3, PRINTED)).error for m in ("mle", "rls")}
    assert np.mean(found["mle"]) == approx(PAPER["mle"][1][0], rel=0.25)
    assert np.mean(found["rls"]) == approx(PAPER["rls"][1][0], rel=0.4)


def test_blocks_of_two_protocols_are_kept_apart() -> None:
    ours, printed = (blocks([CASES[0]], ["mle"], 5, 1, protocol)[0] for protocol in (OURS, PRINTED))
    assert ours.name != printed.name
    assert Block(CASES[0], "mle", 0, 5, 1).name == "case1-mle-seed1-runs0-5"  # of studies that are under way


def test_known_weights_are_those_of_the_declared_noise() -> None:
    """(28) with W = Sigma_tau^-1, against a solver of its own; the estimated ones are others."""
    mechanism, case = motor_mechanism(), CASES[0]
    data = noisy_record(one_step().in_motor_angles(), case, 7, 0)
    options = case_options(case, KNOWN_WLS)
    design = design_rows(split_signals([data], mechanism, options), mechanism, options)
    root = np.array([1.0 / OURS.passive_nm, *[1.0 / np.sqrt(TORQUE_VARIANCE)] * 2])
    expected = np.linalg.lstsq((design.z * root[:, None]).reshape(-1, mechanism.p), (design.torque * root).ravel(),
                               rcond=None)[0]
    assert_allclose(fit([data], mechanism, options, "wls").beta, expected, rtol=1e-6)
    assert not np.allclose(fit([data], mechanism, case_options(case, "wls"), "wls").beta, expected, rtol=1e-3)
