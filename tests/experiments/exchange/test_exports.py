"""What `legid export` writes is read back: to the bit, or as far as the format goes; by other libraries, too."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages
from numpy.testing import assert_allclose, assert_array_equal

from daq import Dataset, Rig, load_rig
from daq.runs import read_run
from daq.timing import decode
from estimator import FitResult, fit
from experiments.exchange import is_native, load_any_run
from experiments.session import setup_of
from tests.support.paths import DEMO_RIG
from tests.support.runs import load_run
from tests.support.shell import Shell, typed


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(DEMO_RIG)


def fitted(run: Dataset, rig: Rig) -> FitResult:
    setup = setup_of([run], rig)
    return fit(setup.datasets, setup.mechanism, setup.options)


@pytest.fixture(scope="module")
def reference(demo_run: Path, rig: Rig) -> FitResult:
    return fitted(load_any_run(demo_run, rig), rig)


@pytest.fixture(scope="module")
def messages_file(demo_run: Path, module_path: Path) -> Path:
    out = module_path / "messages.mcap"
    typed("export", demo_run, "--to ros2 --out", out)
    return out


@pytest.mark.parametrize("kind", ["parquet", "mat"])
def test_to_the_bit(kind: str, demo_run: Path, rig: Rig, tmp_path: Path) -> None:
    out = tmp_path / f"r.{kind}"
    typed("export", demo_run, "--to", kind, "--out", out)
    was, again = load_any_run(demo_run, rig), load_any_run(out, rig)
    assert list(again.columns) == list(was.columns) and again.clock_bound_s == was.clock_bound_s > 0
    assert_array_equal(again.time_s, was.time_s)
    for name, values in was.columns.items():
        assert_array_equal(again[name], values)


def test_a_fit_of_what_comes_back_is_the_same(demo_run: Path, messages_file: Path, rig: Rig, reference: FitResult,
                                              here: Path) -> None:
    """In shares of a standard deviation. CSV keeps 12 digits, stamps of messages nanoseconds."""
    typed("export", demo_run, "--to csv --out r.csv")
    for path, share in ((here / "r.csv", 1e-4), (messages_file, 1e-3)):
        again = fitted(load_any_run(path, rig), rig)
        assert np.abs((again.beta - reference.beta) / reference.std).max() < share
        assert np.abs(again.std / reference.std - 1.0).max() < share


def test_ros2_messages_by_another_library(demo_run: Path, rig: Rig, here: Path,
                                          shell: Shell) -> None:
    """Foxglove's reader decodes them: each sample at its own time of the wall clock, in SI units, right-handed."""
    out = here / "r.mcap"
    shell("export", demo_run, "--to ros2 --out r.mcap")
    assert "temperature_degc" in shell.err
    raw = read_run(demo_run)
    *_, imu = decode(raw, rig).channels
    messages = list(read_ros2_messages(str(out), topics=["/imu"]))
    assert len(messages) == imu.time_s.size > 1000
    stamps = np.array([m.ros_msg.header.stamp.sec * 10**9 + m.ros_msg.header.stamp.nanosec for m in messages])
    assert (np.diff(stamps) > 0).all()
    assert_allclose(np.diff(stamps) * 1e-9, np.diff(imu.time_s), atol=2e-9)
    assert datetime.fromtimestamp(stamps[0] * 1e-9, UTC).year >= 2025
    assert_array_equal([m.ros_msg.angular_velocity.z for m in messages], -imu.columns["gyro_radps"])
    assert_array_equal([m.ros_msg.linear_acceleration.x for m in messages], imu.columns["accel_x_mps2"])
    assert messages[0].ros_msg.orientation_covariance[0] == -1.0
    knee = next(iter(read_ros2_messages(str(out), topics=["/joint_torques"]))).ros_msg
    assert knee.name == ["knee"] and len(knee.effort) == 1


def test_a_native_run_is_told_from_its_export(demo_run: Path, messages_file: Path, tmp_path: Path) -> None:
    assert is_native(demo_run) and not is_native(messages_file)
    (tmp_path / "broken.mcap").write_bytes(b"junk")
    assert is_native(tmp_path / "broken.mcap")  # whose reader says what is wrong


def test_a_csv_becomes_messages_that_count_from_zero(demo_run: Path, rig: Rig, here: Path,
                                                     shell: Shell) -> None:
    shell("export", demo_run, "--to csv --out r.csv")
    shell("export r.csv --to ros2 --out r.mcap")
    assert "no wall clock" in shell.err
    was, again = load_run(here / "r.csv", rig), load_any_run(here / "r.mcap", rig)
    assert len(again) == len(was)
    assert_allclose(again["gyro_radps"], was["gyro_radps"], atol=1e-9)
