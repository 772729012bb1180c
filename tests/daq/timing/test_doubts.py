"""Runs that a second reader of the IMU spoiled, or whose gravity is impossible, are to be doubted."""

from pathlib import Path

import numpy as np
import pytest

from daq.errors import WorkError
from daq.load import load_run
from daq.recording.recorder import record_run
from daq.rig import parse_rig
from daq.runs.mcap_run import read_run
from daq.timing.align import configured
from daq.timing.doubts import doubts
from drivers.leg_controller import LegController
from drivers.lsm9ds1 import Lsm9ds1
from drivers.mock.clock import VirtualClock
from drivers.mock.link import EmulatorLink
from drivers.mock.plant import StillPlant
from drivers.mock.rig import MockRig
from drivers.mock.settings import ImuSettings
from tests.support.recordings import RIG, sine


def record(path: Path, rate: float = 0.012, gravity: float = 9.81, share: float = 0.0):
    """A run whose chip is fast by `rate`, and of whose samples somebody else takes a share once it is driven."""
    clock = VirtualClock()
    mock = MockRig(StillPlant(), clock, ImuSettings(rate_error=rate, gravity_mps2=gravity), seed=2)
    controller = LegController(EmulatorLink(mock.firmware, clock), clock.now_ns)
    controller.open()
    imu = Lsm9ds1(mock.imu, now_ns=clock.now_ns, sleep=clock.sleep)
    imu.open()
    push, rng = mock.imu.push, np.random.default_rng(0)

    def steal(now_s: float, total_s: float) -> None:
        mock.imu.push = lambda raw: None if rng.random() < share else push(raw)

    record_run(path, parse_rig(RIG), RIG, sine(2.5), imu, controller, clock.now_ns, threaded=False, progress=steal)
    return load_run(path, parse_rig(RIG)).sources


def test_a_run_that_is_shared_is_doubted(tmp_path: Path) -> None:
    found = record(tmp_path / "shared.mcap", share=0.1)
    assert "another program may have read it" in found["doubt"]


def test_a_chip_at_another_rate_or_without_gravity_is_refused_before_the_motor_is_armed(tmp_path: Path) -> None:
    with pytest.raises(WorkError, match=r"IMU: 26\d\.\d samples a second, 238 are set; does another program read it"):
        record(tmp_path / "fast.mcap", rate=0.12)
    with pytest.raises(WorkError, match=r"IMU: it measures 1\.6.* gravity is 9\.81"):
        record(tmp_path / "moon.mcap", gravity=1.62)


def test_a_good_run_is_not_doubted_impossible_gravity_is(tmp_path: Path) -> None:
    assert "doubt" not in record(tmp_path / "r.mcap")
    raw = read_run(tmp_path / "r.mcap")
    facts = configured(raw, "imu")
    assert doubts(raw, parse_rig(RIG), facts) == []
    facts["accel_mps2_per_lsb"] *= 0.5
    assert "gravity is 9.81" in doubts(raw, parse_rig(RIG), facts)[0]
