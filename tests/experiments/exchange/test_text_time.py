"""Times as text in logs: dates of three kinds, times of day over midnight, stamps too coarse to use."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.exchange.delimited import read_delimited
from experiments.exchange.text_time import read_times
from tests.support.imported_files import imported, pendulum, rows_of, table
from tests.support.shell import Shell, typed


@pytest.mark.parametrize("cells, seconds", [
    (["2026-11-27T09:16:00.005Z", "2026-11-27T09:16:00.255Z"], [0.0, 0.25]),
    (["2026-11-27 09:16:00+01:00", "2026-11-27 09:16:01+00:00"], [0.0, 3601.0]),
    (["27.11.2026 23:59:59,500", "28.11.2026 00:00:00,250"], [0.0, 0.75]),
    (["12/31/2026 23:59:59", "01/01/2027 00:00:01"], [0.0, 2.0]),
    (["13/02/2026 10:00:00", "14/02/2026 10:00:00"], [0.0, 86400.0]),
    (["23:59:58.5", "00:00:01.5"], [86398.5, 1.5]),
    (["", "2026-01-01 00:00:00", "2026-01-01 00:00:02"], [np.nan, 0.0, 2.0])])
def test_dates_and_times_of_day_become_seconds(cells: list[str], seconds: list[float]) -> None:
    found = read_times(cells)
    assert found is not None
    assert_allclose(found, seconds, atol=1e-9)


@pytest.mark.parametrize("cells", [["abc", "def"], ["2026-13-01 00:00:00"] * 3, ["1.5", "2.5"], ["", ""],
                                   ["2026-01-01 00:00:00", "ok", "off"]])
def test_words_are_no_times(cells: list[str]) -> None:
    assert read_times(cells) is None


def written(path: Path, head: str, stamps: list[str], *columns: np.ndarray, separator: str = ",") -> Path:
    lines = [separator.join([stamp, *(f"{value:.6f}".replace(".", "," if separator == ";" else ".") for value in row)])
             for stamp, row in zip(stamps, zip(*columns))]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    return path


def test_a_log_over_midnight_is_imported(tmp_path: Path) -> None:
    t, q, tau = pendulum()
    stamps = [f"{int(s // 3600) % 24:02d}:{int(s // 60) % 60:02d}:{s % 60:06.3f}" for s in 86395.0 + t]
    run = rows_of(imported(written(tmp_path / "x.csv", "clock,angle,torque", stamps, q, tau)))
    assert len(run) == t.size
    assert_allclose(run[:, 0] - run[0, 0], t, atol=1e-6)
    assert_allclose(run[:, 1], q, atol=1e-5)


def test_a_german_log_with_its_line_of_units_is_imported(tmp_path: Path) -> None:
    t, q, tau = pendulum()
    stamps = [f"27.11.2026 09:16:{int(s):02d},{round(1e3 * (s % 1)):03d}" for s in t]
    file = written(tmp_path / "x.csv", "Zeitstempel;Winkel;Drehmoment\n;°;N·m", stamps, np.degrees(q), tau,
                   separator=";")
    run = rows_of(imported(file))
    assert_allclose(run[:, 0], t, atol=1e-6)
    assert_allclose(run[:, 1], q, atol=1e-5)


def test_stamps_that_are_too_coarse_say_so(here: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    for name, stamps, told in (("a.csv", [f"10:00:{s - s % 0.1:06.3f}" for s in t], "--rate HZ"),
                               ("b.csv", [f"{1.764235e9 + s:.6e}" for s in t], "its times have 7 digits only")):
        file = written(here / name, "time,angle,torque", stamps, q, tau)
        err = shell.fails("import", file, "--guess --map c.toml")
        assert "stands still" in err and told in err and "sort" not in err
        shell("import", file, "--guess --rate 100 --map r.toml")
        (here / "r.toml").unlink()


def test_a_counter_of_microseconds_that_wraps_goes_on(tmp_path: Path, shell: Shell) -> None:
    t, q, tau = pendulum()
    stamps = [f"{(2**32 - 5_000_000 + round(1e6 * s)) % 2**32}" for s in t]
    run = rows_of(imported(written(tmp_path / "x.csv", "time_us,angle_rad,torque_nm", stamps, q, tau)))
    assert_allclose(np.diff(run[:, 0]), 0.01, atol=1e-6)
    assert "wraps once by 4294.967296" in shell.err


def test_a_clock_that_starts_again_is_cut_not_sorted(here: Path, shell: Shell) -> None:
    t = np.tile(np.arange(300) * 0.01, 2)
    table(here / "run.csv", {"time_s": t, "q1_rad": np.sin(t), "tau1_nm": np.cos(t)})
    assert "the clock starts again there: cut the file at line 302" in shell.fails("info run.csv")


def test_a_header_with_labels_names_its_channels(tmp_path: Path) -> None:
    t, q, tau = pendulum()
    head = ('Timestamp,2026-01-01 10:00:00,Timestamp,2026-01-01 10:00:00\nChannel name,"Angle",Channel name,"Torque"\n'
            'Unit,"deg",Unit,"mNm"')
    file = written(tmp_path / "x.csv", head, [f"{s:.3f}" for s in t], np.degrees(q), t, 1e3 * tau)
    assert read_delimited(file).names == ["Angle time", "Angle [deg]", "Torque time", "Torque [mnm]"]
    assert_allclose(rows_of(imported(file))[:, 2], tau, atol=1e-5)


@pytest.mark.parametrize("head", ["", "angle_rad\n"])
def test_one_column_at_a_known_rate_is_a_run(head: str, here: Path) -> None:
    angle = np.sin(np.arange(500) * 0.02)
    (here / "swing.txt").write_text(head + "".join(f"{a:.5f}\n" for a in angle))
    (here / "m.toml").write_text(f'[columns.q1_rad]\nname = "{head.strip() or "column 1"}"\n')
    typed("import swing.txt --map m.toml --rate 250 --out out")
    run = rows_of(here / "out/swing.csv")
    assert_allclose(run, np.column_stack([np.arange(500) / 250.0, angle]), atol=1e-5)
