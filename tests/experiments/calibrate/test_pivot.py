"""`legid calibrate pivot`: the sensor's zero from stops of a leg, with an IMU and without."""

import math
from pathlib import Path

import numpy as np
import pytest

from daq import load_rig
from daq.runs import RunWriter
from tests.support.motor_off_runs import RIG, add_imu, hanging
from tests.support.shell import Shell, typed

TABLE = "[devices.pivot]\nsign = {sign}\n"


def write_stop(path: Path, reading_rad: float, q1_rad: float | None = None, status: int = 0x20, drift: float = 0.0,
               seed: int = 0) -> str:
    """Ten seconds of a chip that reads `reading_rad`, and of an IMU that hangs at `q1_rad`."""
    rng, writer = np.random.default_rng(seed), RunWriter(path, {"rig.toml": RIG})
    for k in range(2000):
        t_ns, angle = 10**9 + k * 5_000_000, reading_rad + drift * k / 2000 + 7e-4 * rng.standard_normal()
        writer.add("/pivot", t_ns, t_ns, t_ns + 200_000, round(angle / math.tau * 4096) % 4096, 2000, status, 64)
    if q1_rad is not None:
        add_imu(writer, hanging(q1_rad, 10.0, seed))
    writer.close()
    return str(path)


def calibrate(folder: Path, sign: int, *runs: str) -> float:
    rig = folder / "rig.toml"
    rig.write_text(RIG + TABLE.format(sign=sign))
    typed("calibrate pivot", *runs, "--rig", rig)
    return load_rig(rig).calibration.pivot_zero_rad


@pytest.mark.parametrize("sign", [1, -1])
def test_the_imu_tells_where_link_1_hangs(tmp_path: Path, sign: int, shell: Shell) -> None:
    """The chip's wrap lies among the readings: their mean is that of angles, not of counts."""
    zero = sign * 0.002 if sign > 0 else 3.14
    runs = [write_stop(tmp_path / f"{k}.mcap", sign * (zero + q1), q1, seed=k)
            for k, q1 in enumerate([0.052, -0.04, 0.02])]
    found = calibrate(tmp_path, sign, *runs)
    assert math.remainder(found - zero, math.tau) == pytest.approx(0.0, abs=1e-3)
    assert load_rig(tmp_path / "rig.toml").tolerances["encoder_offset@1"][0] == pytest.approx(0.1 / 9.81, rel=0.1)
    said = shell.out
    assert "95 %, from 3 records" in said and "link 1 hangs at +0.05" in said


def test_without_an_imu_the_leg_is_taken_to_hang_straight(tmp_path: Path, shell: Shell) -> None:
    assert calibrate(tmp_path, 1, write_stop(tmp_path / "a.mcap", 1.2)) == pytest.approx(1.2, abs=1e-3)
    assert not load_rig(tmp_path / "rig.toml").tolerances  # friction holds the pivot, one record does not say how far
    said = shell.read()
    assert "without an IMU" in said.out and "each reached from the other side" in said.err


@pytest.mark.parametrize("more, status, line", [
    ({"status": 0}, 2, "holds 0 valid readings of a pivot sensor"), ({"drift": 0.1}, 1, "the pivot moved by 0.")])
def test_what_is_no_rest_is_refused(here: Path, shell: Shell, more: dict, status: int, line: str) -> None:
    (here / "rig.toml").write_text(RIG)
    write_stop(here / "a.mcap", 1.2, **more)
    shell("calibrate pivot a.mcap --rig rig.toml", status=status)
    assert line in shell.err
