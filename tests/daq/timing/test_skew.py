"""Residual skew between gyro and pivot angle against delays that were put in, and what `legid info` says of clocks."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from daq import Dataset, load_rig
from daq.runs import RunWriter, read_run
from daq.timing import measure_skew
from experiments.reports import describe_mcap
from tests.support.paths import DEMO_RIG
from tests.support.runs import load_run

RATE = 200.0
RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'


def swing(late_s: float, seed: int = 0, seconds: float = 20.0, size: float = 1.0) -> Dataset:
    """Two tones; Hall angle in steps of 1/1024 turn, gyro with bias, scale error and noise, `late_s` late."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1 / RATE)
    angle = size * (0.4 * np.sin(2.1 * t) + 0.2 * np.sin(5.3 * t + 1.0))
    rate = size * (0.84 * np.cos(2.1 * (t - late_s)) + 1.06 * np.cos(5.3 * (t - late_s) + 1.0))
    step = 2 * np.pi / 1024
    hall = np.rint((angle + 0.002 * rng.standard_normal(t.size)) / step) * step
    gyro = 1.01 * rate + 0.02 + 0.005 * rng.standard_normal(t.size)
    return Dataset("swing", RATE, t, {"q1_rad": hall, "gyro_radps": gyro})


@pytest.mark.parametrize("late_s", [-0.031, -0.004, 0.0, 0.0007, 0.005, 0.06])
def test_a_delay_is_found_with_its_sign(late_s: float) -> None:
    for seed in range(4):
        skew = measure_skew(swing(late_s, seed))
        assert skew.std_s < 3e-4 and skew.seconds == pytest.approx(late_s, abs=min(5e-4, 5 * skew.std_s))


def test_holes_are_left_out() -> None:
    run = swing(0.005)
    run.columns["gyro_radps"][500:520] = np.nan
    assert measure_skew(run).seconds == pytest.approx(0.005, abs=5e-4)


def test_without_motion_or_without_a_pivot_angle_nothing_is_said() -> None:
    assert measure_skew(swing(0.005, size=0.0)) is None
    run = swing(0.005)
    del run.columns["q1_rad"]  # type: ignore[attr-defined]
    assert measure_skew(run) is None
    assert measure_skew(swing(0.0, seconds=0.5)) is None


def write_run(path: Path, trip_s: float, timer_ms: int | None = None) -> None:
    """Telemetry at 500 Hz and probes of this round trip, 4 s."""
    writer = RunWriter(path, {"rig.toml": RIG})
    if timer_ms is not None:
        facts = {"kind": "serial", "port": "/dev/ttyUSB0", "latency_timer_ms": timer_ms}
        writer.config(0, "link", msgspec.json.encode(facts).decode())
    for k in range(2000):
        t = k * 0.002
        host = round(1e9 * (1 + t + trip_s))
        writer.add("/leg/telemetry", host, host, np.sin(t), 0.0, 0.0, 0.0, 24.0, 25.0, 0.0, round(t * 1e6), 5, k, 0, 0)
    for k, t in enumerate(np.arange(0.1, 3.9, 0.25)):
        tx, rx, tick = round(1e9 * (1 + t)), round(1e9 * (1 + t + trip_s)), round((t + trip_s / 2) * 1e6)
        writer.add("/leg/clock", rx, tx, rx, tick, tick, 5, k)
    writer.close()


def test_info_warns_of_a_loose_clock_and_names_the_latency_timer(tmp_path: Path) -> None:
    write_run(tmp_path / "good.mcap", 0.4e-3, 1)
    assert "warning" not in describe_mcap(read_run(tmp_path / "good.mcap"))
    write_run(tmp_path / "loose.mcap", 6e-3, 16)
    words = describe_mcap(read_run(tmp_path / "loose.mcap"))
    for said in ("warning: the controller's clock is known to 3.",
                 "latency timer was 16 ms; echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
                 "within 3"):  # the bound itself stands in the clock's own line
        assert said in words


def test_an_emulated_run_shows_the_age_of_its_gyro(demo_run: Path) -> None:
    skew = measure_skew(load_run(demo_run, load_rig(DEMO_RIG), 200.0))
    assert skew.seconds == pytest.approx(1.0 / (2.0 * np.pi * 100.0), abs=5 * skew.std_s + 0.5e-3)  # low pass at 476 Hz
    words = describe_mcap(read_run(demo_run))
    assert "IMU against encoders, by correlation" in words and "its low pass alone: +1.92 +- 0.45 ms" in words
