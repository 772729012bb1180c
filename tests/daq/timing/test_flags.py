"""Runs that a second reader of the IMU spoiled, or whose gravity is impossible, are to be doubted."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from daq import InputError, WorkError, parse_rig
from daq.runs import read_run
from daq.timing import configured, decode
from daq.timing.align import align
from daq.timing.flags import _repeated, _unmarked, flag_run
from drivers.mock import ImuSettings
from tests.support.drained import drained
from tests.support.recordings import RIG, sine
from tests.support.virtual_rig import VirtualRig


def record(path: Path, rate: float = 0.012, gravity: float = 9.81, share: float = 0.0, burst: int = 0) -> str:
    """A run whose chip is fast by `rate`, and of whose samples somebody else takes a share once it is driven, or one
    burst."""
    rig = VirtualRig(imu=ImuSettings(rate_error=rate, gravity_mps2=gravity), seed=2).open()
    push, rng, left = rig.mock.imu.push, np.random.default_rng(0), [burst]

    def taken() -> bool:
        left[0] -= 1
        return left[0] >= 0 or rng.random() < share

    def steal(now_s: float, total_s: float) -> None:
        if now_s > 1.2:
            rig.mock.imu.push = lambda raw: None if taken() else push(raw)

    rig.save(path, RIG, sine(2.5), progress=steal)
    return "; ".join(map(str, align(read_run(path), parse_rig(RIG)).flags))


def test_a_run_with_a_second_reader_is_flagged(path: Path) -> None:
    assert "another program may have read it" in record(path, share=0.1)


def test_a_run_without_one_burst_is_flagged(tmp_path: Path) -> None:
    """Six of 900 samples: the rate is as it was, but all later ones are 25 ms early."""
    assert "missing without a mark" in record(tmp_path / "burst.mcap", burst=6)


@pytest.mark.parametrize("rate", [119.0, 240.9, 923.4])
@pytest.mark.parametrize("every_s", [0.003, 0.01, 0.02])
def test_drains_contradict_each_other_only_where_samples_are_missing(rate: float, every_s: float) -> None:
    """Drains held up, and looks that take long, are no reason to doubt; three samples less are, wherever they were."""
    nominal = min((119.0, 238.0, 952.0), key=lambda hz: abs(hz - rate))
    for seed in range(10):
        rng = np.random.default_rng(seed)
        m = int(6.0 * rate)
        samples = drained(rng, np.sort((np.arange(m) + 0.02 * rng.standard_normal(m)) / rate), every_s, 4.0)
        assert not _unmarked(samples, nominal)
        begins = np.flatnonzero(np.diff(samples["drain_before_ns"])) + 1
        at = begins[int(rng.uniform(0.1, 0.9) * begins.size)]
        less = np.concatenate((samples[:at], samples[at + 3:]))
        less["index"][at:] -= 3
        assert "another program may have read it" in _unmarked(less, nominal)[0].text


def test_repeated_samples_are_flagged_a_quiet_chip_is_not() -> None:
    rng = np.random.default_rng(3)
    quiet = np.rint(rng.normal(0.0, 0.8, (20_000, 6))).astype(np.int16)
    assert (np.diff(quiet, axis=0) == 0).all(axis=1).sum() > 5 and not _repeated(quiet)
    lively = np.rint(rng.normal(0.0, 8.0, (20_000, 6))).astype(np.int16)
    assert not _repeated(lively)
    lively[700:703] = lively[699]
    assert "3 IMU samples repeat the one before" in _repeated(lively)[0].text
    quiet[900:1000] = quiet[899]
    assert _repeated(quiet)


@pytest.mark.parametrize("rate", ['"fast"', "1e308", "5e-324", "-238", "[238]"])
def test_a_rate_that_no_chip_has_is_refused(rate: str, path: Path) -> None:
    record(path)
    raw = read_run(path)
    notes = [note._replace(text=re.sub(r'"rate_hz":[^,}]*', f'"rate_hz":{rate}', note.text)) for note in raw.config]
    with pytest.raises(InputError, match=r"r\.mcap"):
        decode(dataclasses.replace(raw, config=notes), parse_rig(RIG))


def test_a_chip_at_another_rate_or_without_gravity_is_refused_before_the_motor_is_armed(tmp_path: Path) -> None:
    with pytest.raises(WorkError, match=r"IMU: 26\d\.\d samples a second, 238 are set; does another program read it"):
        record(tmp_path / "fast.mcap", rate=0.12)
    with pytest.raises(WorkError, match=r"IMU: it measures 1\.6.* gravity is 9\.81"):
        record(tmp_path / "moon.mcap", gravity=1.62)


def test_a_good_run_is_not_flagged_impossible_gravity_is(path: Path) -> None:
    assert not record(path)
    raw = read_run(path)
    facts = configured(raw, "imu")
    assert flag_run(raw, parse_rig(RIG), facts) == []
    facts["accel_mps2_per_lsb"] *= 0.5
    assert "gravity is 9.81" in flag_run(raw, parse_rig(RIG), facts)[0].text
