"""CSV by the contract: what is read, what is refused and in which words, and that writing reads back."""

import gzip
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from daq import Dataset, InputError, Rig, load_rig, parse_rig
from daq.runs import read_csv, write_csv
from tests.support.paths import REAL
from tests.support.runs import load_run

LEG = parse_rig('[mechanism]\nmodel = "leg2"\nactuated = [2]\n')
NAMES = ["time_s", "q2_rad", "tau2_nm", "gyro_radps", "accel_x_mps2", "accel_y_mps2"]


def rig(model: str, actuated: str, more: str = "") -> Rig:
    return parse_rig(f'[mechanism]\nmodel = "{model}"\nactuated = {actuated}\n{more}')


JOINT, VOLTS = rig("joint1", "[1]"), rig("joint1", "[1]", 'input = "voltage"\n')
BIPED = rig("biped3", "[2, 3]")


def rows(count: int = 60, names: list[str] = NAMES) -> list[list[str]]:
    return [[f"{0.01 * i:.3f}", *(f"{i + j}.5" for j in range(1, len(names)))] for i in range(count)]


def put(path: Path, cells: list[list[str]], names: list[str] = NAMES) -> Path:
    path.write_text("\n".join([",".join(names), *(",".join(line) for line in cells)]) + "\n")
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A sound run of the leg."""
    return put(tmp_path / "r.csv", rows())


def refused(path: Path, *words: str, rig: Rig | None = LEG) -> None:
    with pytest.raises(InputError) as caught:
        read_csv(path, rig)
    said = str(caught.value)
    assert "\n" not in said and all(one in said for one in words), said


def test_numbers_come_through_exactly(path: Path) -> None:
    table = read_csv(path, LEG)
    assert table.name == "r.csv" and list(table.columns) == NAMES[1:]
    assert_array_equal(table.time_s, [float(f"{0.01 * i:.3f}") for i in range(60)])
    assert_array_equal(table.columns["tau2_nm"], np.arange(60) + 2.5)


@pytest.mark.parametrize("change", [
    lambda text: "\ufeff" + text, lambda text: text.replace("\n", "\r\n"), lambda text: text.replace("\n", "\r"),
    lambda text: text + "\n\n", lambda text: text.replace("q2_rad", '" q2_rad "'), lambda text: text.rstrip("\n"),
    lambda text: text.replace("0.010,", '"0.010", '),
], ids=["byte order mark", "CRLF", "CR", "blank lines", "quoted header", "no newline at the end", "quoted cell"])
def test_dialects_that_spreadsheets_write(path: Path, change) -> None:
    want = read_csv(path).columns["q2_rad"]
    path.write_bytes(change(path.read_text()).encode())
    assert_array_equal(read_csv(path, LEG).columns["q2_rad"], want)


@pytest.mark.parametrize("line, column, cell, words", [
    (31, "tau2_nm", "off", "'off' is not a number"), (31, "gyro_radps", "nan", "NaN"), (60, "q2_rad", "", "empty"),
    (2, "accel_y_mps2", "-inf", "infinite"), (61, "time_s", "1e999", "infinite"), (5, "q2_rad", "1_0", "not a number"),
])
def test_a_bad_cell_is_named_by_line_and_column(path: Path, line: int, column: str, cell: str, words: str) -> None:
    cells = rows()
    cells[line - 2][NAMES.index(column)] = cell
    refused(put(path, cells), f"r.csv, line {line}, column {column}", words)


def test_blank_lines_do_not_shift_the_line_named(path: Path) -> None:
    cells = rows()
    cells[40][2] = "x"
    path.write_text(put(path, cells).read_text().replace("0.100,", "\n\n0.100,"))
    refused(path, "line 44, column tau2_nm")


@pytest.mark.parametrize("value, words", [("0.100", "repeats"), ("0.050", "backwards")])
def test_time_must_increase(path: Path, value: str, words: str) -> None:
    cells = rows()
    cells[11][0] = value
    refused(put(path, cells), "line 13, column time_s", words)


def test_a_quotation_mark_without_a_second_one_is_named_by_its_line(path: Path) -> None:
    """It ended in an internal error: the cell went on to the end of the file."""
    lines = path.read_text().split("\n")
    head, _, last = lines[30].rpartition(",")
    lines[30] = f'{head},"{last}'
    path.write_text("\n".join(lines))
    refused(path, "r.csv, line 31", "CSV")


def test_a_ragged_line_is_named(path: Path) -> None:
    cells = rows()
    for line, words in ((cells[20][:4], "accel_x_mps2: the line has 4 cells, the header 6"),
                        ([*cells[20], "9"], "accel_y_mps2: the line has 7 cells")):
        cells[20] = line
        refused(put(path, cells), f"line 22, column {words}")


def test_too_short_and_empty_files(path: Path) -> None:
    refused(put(path, rows(49)), "holds 49 samples, at least 50")
    assert read_csv(put(path, rows(50)), LEG).time_s.size == 50
    refused(put(path, []), "holds 0 samples")
    for text, words in (("", "r.csv: is empty"), ("\n1,2\n", "no header")):
        path.write_text(text)
        refused(path, words)


def test_headers_that_mislead(path: Path) -> None:
    semicolons = path.read_text().replace(",", ";")
    for names, words in ((["time_s", "q2_rad", "q2_rad", *"abc"], "names column q2_rad twice"),
                         ([*NAMES[:5], ""], "unnamed column"),
                         (["time_s", "q2_deg", *NAMES[2:]], "rename q2_deg to q2_rad")):
        refused(put(path, rows(), names), words)
    path.write_text(semicolons)
    refused(path, "not comma separated")


def test_files_that_cannot_be_opened(path: Path) -> None:
    folder, packed = path.parent, path.parent / "z.csv.gz"
    refused(folder / "none.csv", "No such file")
    refused(folder, "directory")
    whole = gzip.compress(path.read_bytes())
    for data in (b"time_s,q2_rad\n", whole[:5], whole[: len(whole) // 2], whole[:-3]):
        packed.write_bytes(data)
        refused(packed, "z.csv.gz: cannot be unpacked as gzip")
    packed.write_bytes(whole)
    assert read_csv(packed, LEG).time_s.size == 60
    path.write_bytes(b"time_s,q2_rad\n\xff\xfe,1\n")
    refused(path, "r.csv, line 2: is not UTF-8")


@pytest.mark.parametrize("rig_, names, column", [
    (LEG, "q2_rad tau2_nm gyro_radps accel_x_mps2 accel_y_mps2", "time_s"), (LEG, "time_s tau2_nm q1_rad", "q2_rad"),
    (LEG, "time_s q2_rad q1_rad", "tau2_nm"), (LEG, "time_s q2_rad tau2_nm", "q1_rad"),
    (LEG, "time_s q2_rad tau2_nm gyro_radps accel_x_mps2", "accel_y_mps2"),
    (rig("leg2", "[1, 2]"), " ".join(NAMES), "tau1_nm"),
    (rig("leg2", "[1]"), "time_s q2_rad q1_rad tau1_nm", "tau2_nm"), (JOINT, "time_s tau1_nm", "q1_rad"),
    (JOINT, "time_s q1_rad", "tau1_nm"), (JOINT, "time_s q1_m tau1_nm", "tau1_n"),
    (VOLTS, "time_s q1_rad volts", "duty"), (BIPED, "time_s q1_rad q2_rad tau2_nm tau3_nm", "q3_rad"),
    (BIPED, "time_s q1_rad q2_rad q3_rad tau2_nm", "tau3_nm"),
    (rig("chain", "[4]", "links = 4\n"), "time_s q1_rad q2_rad q3_rad q4_rad", "tau4_nm")])
def test_a_missing_column_is_named(path: Path, rig_: Rig, names: str, column: str) -> None:
    put(path, rows(60, names.split()), names.split())
    refused(path, f"line 1: column {column} is missing", rig=rig_)


@pytest.mark.parametrize("rig_, names", [
    (LEG, "time_s q2_rad tau2_nm q1_rad"), (JOINT, "time_s q1_m tau1_n"), (rig("joint1", "[]"), "time_s q1_rad"),
    (rig("leg2", "[]"), "time_s q2_rad q1_rad"), (VOLTS, "time_s q1_rad duty volts"),
    (rig("biped3", "[3]"), "time_s q1_rad q2_rad q3_rad tau3_nm")])
def test_complete_runs_of_each_mechanism(path: Path, rig_: Rig, names: str) -> None:
    found = read_csv(put(path, rows(60, names.split()), names.split()), rig_)
    assert {"time_s", *found.columns} == set(names.split())


def test_a_servo_by_voltage_is_told_so(path: Path) -> None:
    names = ["time_s", "q1_rad", "duty", "volts"]
    refused(put(path, rows(60, names), names), 'input = "voltage"', rig=JOINT)


def test_extra_columns_are_kept_and_text_in_them_harms_nobody(path: Path) -> None:
    names = [*NAMES, "battery_v", "note"]
    cells = [[*line[:-1], "up" if i % 2 else ""] for i, line in enumerate(rows(60, names))]
    table = read_csv(put(path, cells, names), LEG)
    assert_array_equal(table.columns["battery_v"], np.arange(60) + 6.5)
    assert "note" not in table.columns and table.ignored == ("note",)
    cells[3][6] = "nan"
    assert read_csv(put(path, cells, names), LEG).ignored == ("battery_v", "note")
    names[-1] = "temperature_degc"  # a column with a meaning is checked though nobody requires it
    cells[3][6] = "7.2"
    refused(put(path, cells, names), "line 2, column temperature_degc")


def test_sixty_thousand_rows_are_read_at_once(path: Path) -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack([np.arange(60_000) * 1e-3, rng.normal(size=(60_000, 7))])
    np.savetxt(path, table, delimiter=",", fmt="%.9g", comments="",
               header=",".join([*NAMES, "tau2_cmd_nm", "temperature_degc"]))
    start = time.process_time()
    got = read_csv(path, LEG)
    assert time.process_time() - start < 2.0  # processor time, some 0.1 s on an idle core
    assert_allclose(got.columns["q2_rad"], table[:, 1], rtol=1e-8)


@pytest.mark.parametrize("name", ["out.csv", "out.csv.gz"])
def test_writing_reads_back_and_a_gap_stays_a_gap(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(1)
    columns = {column: rng.normal(size=400) for column in NAMES[1:]} | {"q1_rad": np.full(400, np.nan)}
    for column in NAMES[3:]:
        columns[column][100:130] = np.nan
    run = Dataset("run", 100.0, 12.34 + np.arange(400) / 100.0, columns)
    assert write_csv(run, tmp_path / name) == 370
    again = load_run(tmp_path / name, LEG)
    assert "q1_rad" not in again and again.rate_hz == 100.0
    assert_allclose(again.time_s, run.time_s, atol=2e-9)
    assert_array_equal(np.flatnonzero(again.gap()), np.arange(100, 130))
    for column in NAMES[1:]:
        assert_allclose(again[column][~again.gap()], run[column][~again.gap()], rtol=1e-11)
    with pytest.raises(InputError, match="No such file"):
        write_csv(run, tmp_path / "nowhere" / name)


@pytest.mark.skipif(not REAL.is_dir(), reason="real data sets are not on this machine")
@pytest.mark.parametrize("folder, file, rig_file, samples", [
    ("dfki_c0", "03_passive.csv.gz", "rig_passive.toml", 5000), ("dfki_a0", "12.csv.gz", "rig.toml", 5000),
    ("multiarm", "free_swing.csv.gz", "rig.toml", 53340), ("emps", "estimation.csv.gz", "rig.toml", 24841),
])
def test_measured_runs_are_read(folder: str, file: str, rig_file: str, samples: int) -> None:
    run = load_run(REAL / folder / file, load_rig(REAL / folder / rig_file))
    assert len(run) == samples and run.gap().mean() < 0.005


def test_a_small_file_that_unpacks_to_a_gigabyte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    piece = zlib.compressobj(9, wbits=31)
    data = piece.compress(b"time_s,q\n") + b"".join(piece.compress(b"0,0\n" * (1 << 18)) for _ in range(60))
    path.write_bytes(data + piece.flush())
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match="unpacks to more than"):
        read_csv(path)


@pytest.mark.parametrize("text", ["time_s," + "x" * 140_000 + "\n1,2\n", "time_s,q\n1," + "2" * 140_000 + "\n2,x\n"])
def test_a_cell_beyond_all_measure_is_named(text: str, path: Path) -> None:
    path.write_text(text)
    with pytest.raises(InputError, match=r"line [12]"):
        read_csv(path)
