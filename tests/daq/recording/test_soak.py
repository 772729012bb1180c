"""Short runs of the soak study: nothing lost or doubled, and what a killed recorder leaves."""

from pathlib import Path

import pytest

from evidence.soak import kill_many, soak_real, soak_virtual


def test_952_hz_and_1_khz_on_virtual_time_lose_nothing(tmp_path: Path) -> None:
    found = soak_virtual(tmp_path, 8.0)
    assert found["imu_samples"] > 8 * 952
    assert found["frames"] > 8 * 1000
    assert found["imu_jumps"] == found["imu_torn"] == found["imu_gaps_marked"] == 0
    assert found["frames_lost"] == found["frames_doubled"] == 0


def test_on_the_real_clock_no_loss_goes_unmarked(tmp_path: Path) -> None:
    found, share = soak_real(tmp_path, 2.0)
    assert found["frames_doubled"] == 0
    assert found["frames"] > 1000
    assert found["imu_doubled"] == found["imu_torn"] == 0
    assert found["imu_jumps"] <= found["imu_gaps_marked"]
    assert found["imu_samples"] > 500
    assert share > 0


@pytest.mark.slow
def test_killed_recordings_recover(tmp_path: Path) -> None:
    for killed in kill_many(tmp_path, 3, seed=5):
        assert killed.good, killed
        assert killed.handed_over > 0
