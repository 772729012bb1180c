"""Alignment: closed forms for the filters, gaps that stay gaps, and an emulated run whose motion is known."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from daq import Dataset, InputError, parse_rig
from daq.recording import Plan
from daq.runs import RawTable, RunWriter, read_run
from daq.timing import TimedColumns, align_channels, align_table, decode, recorded_rig
from daq.timing.resample import snapped_times
from drivers.mock import FirmwareSettings, ImuSettings, MockRig
from tests.support.runs import load_run
from tests.support.still_plant import MovingPlant
from tests.support.virtual_rig import VirtualRig


def table(time_s: np.ndarray, **columns: np.ndarray) -> RawTable:
    return RawTable("t", time_s, columns)


def test_samples_on_the_grid_are_taken_as_they_are() -> None:
    rng, t = np.random.default_rng(0), 3.0 + np.arange(500) / 200.0
    values = rng.normal(size=500)
    run = align_table(table(t + rng.uniform(-0.4e-2, 0.4e-2, 500) / 200.0, q2_rad=values), 200.0)
    assert_array_equal(run["q2_rad"], values)
    assert_allclose(np.diff(run.time_s), 0.005, rtol=1e-9)


def test_an_oscillator_100_ppm_off_is_not_resampled_and_a_thousandth_is() -> None:
    values, index = np.random.default_rng(1).normal(size=5000), np.arange(5000)
    assert_array_equal(align_table(table(index * 1.00005e-3, q=values), 1000.0)["q"], values)
    assert not np.array_equal(align_table(table(index * 1.001e-3, q=values), 1000.0)["q"][:5000], values)
    jittered = index * 1e-3 + np.random.default_rng(2).uniform(-5e-5, 5e-5, 5000)
    assert_array_equal(snapped_times(jittered, 1000.0), jittered)


def test_jittered_samples_of_the_grids_rate_are_splined() -> None:
    t = np.cumsum(np.random.default_rng(3).uniform(0.6, 1.4, 1000)) * 0.01
    run = align_table(table(t, q=np.sin(2 * np.pi * 2.0 * t)), 100.0)
    inner = slice(5, -5)
    assert_allclose(run["q"][inner], np.sin(2 * np.pi * 2.0 * run.time_s)[inner], atol=3e-4)
    assert not run.gap().any()


def test_two_samples_that_almost_coincide_do_not_make_the_spline_ring() -> None:
    t = np.arange(200) * 0.01
    t[100] = t[99] + 1e-6
    q = np.zeros(200)
    q[100] = 1e-3
    assert np.abs(align_table(table(t, q=q), 100.0)["q"]).max() <= 1e-3


def test_fast_samples_are_averaged_over_the_centred_window() -> None:
    """The mean of sin(wt) over [t - d/2, t + d/2] is sin(wt) * sin(wd/2) / (wd/2)."""
    t = np.cumsum(np.random.default_rng(4).uniform(0.8, 1.2, 20_000)) * 1e-4
    w, d = 2 * np.pi * 8.0, 0.01
    run = align_table(table(t, q2_rad=np.sin(w * t), tau2_nm=np.cos(w * t)), 100.0)
    shrink = math.sin(w * d / 2) / (w * d / 2)
    assert_allclose(run["q2_rad"], shrink * np.sin(w * run.time_s), atol=1e-5)
    assert_allclose(run["tau2_nm"], shrink * np.cos(w * run.time_s), atol=1e-5)


def test_the_window_mean_integrates_straight_lines_exactly() -> None:
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.5, 1.5, 300)) * 1e-3
    q = rng.normal(size=300)
    run = align_table(table(t, q=q), 100.0)
    for k in range(len(run)):
        window = np.linspace(run.time_s[k] - 0.005, run.time_s[k] + 0.005, 100_001)
        assert run["q"][k] == pytest.approx(np.trapezoid(np.interp(window, t, q), window) / 0.01, abs=1e-6)


def test_channels_of_different_rates_carry_the_same_filter() -> None:
    """A slow channel beside a fast one gets the same window, so that their relation is not bent."""
    w = 2 * np.pi * 5.0
    fast, slow = np.arange(0, 10, 1 / 500), np.arange(0.0013, 10, 1 / 119)
    channels = [TimedColumns(fast, {"a": np.sin(w * fast)}), TimedColumns(slow, {"b": np.sin(w * slow)})]
    run = align_channels("r", channels, 100.0)
    inner = slice(5, -5)
    assert_allclose(run["a"][inner], run["b"][inner], atol=5e-4)
    assert run.time_s[0] >= 0.0013 + 0.005


@pytest.mark.parametrize("missing, stays", [(1, False), (2, True), (30, True)])
def test_holes_longer_than_two_and_a_half_periods_stay_holes(missing: int, stays: bool) -> None:
    t = np.arange(400) * 0.01
    kept = np.delete(np.arange(400), np.arange(200, 200 + missing))
    run = align_table(table(t[kept], q=np.sin(t[kept])), 100.0)
    want = np.arange(200, 200 + missing) if stays else np.empty(0)
    assert_array_equal(np.flatnonzero(run.gap()), want)
    assert_allclose(run["q"][~run.gap()], np.sin(run.time_s[~run.gap()]), atol=1e-9)


def test_a_hole_in_fast_samples_empties_every_window_that_touches_it() -> None:
    t = np.arange(10_000) * 1e-3
    kept = (t < 4.0005) | (t > 4.0105)
    run = align_table(table(t[kept], q=t[kept]), 100.0)
    gone = run.time_s[run.gap()]
    assert gone.size in (1, 2, 3) and np.abs(gone - 4.0055).max() < 0.0105
    assert_allclose(run["q"][~run.gap()], run.time_s[~run.gap()], rtol=1e-12)


def test_a_time_far_off_is_refused_before_it_fills_the_memory() -> None:
    t = np.arange(600) * 0.01
    t[-1] = 1e12
    with pytest.raises(InputError, match="check that time_s is in seconds"):
        align_table(table(t, q=t), 100.0)


def test_milliseconds_taken_for_seconds_are_refused_before_anything_is_interpolated() -> None:
    for step in (10.0, 1.0):  # 100 Hz and 1 kHz
        with pytest.raises(InputError, match=rf"a sample every {step:.0f} s.*unit = \"ms\""):
            align_table(table(np.arange(600) * step, q=np.zeros(600)), 100.0)
    slow = align_table(table(np.arange(600) * 0.2, q=np.zeros(600)), 100.0)
    assert slow.rate_hz == 5.0 and "nothing is interpolated" in str(slow.flags[0])


A, W, B, V = 0.5, 2 * math.pi * 0.8, 0.7, 2 * math.pi * 1.1


def swing(t: float) -> SimpleNamespace:
    """Prescribed motion: q1 = A sin(Wt), q2 = B sin(Vt), t from the start of the physics."""
    return SimpleNamespace(q1=A * math.sin(W * t), q1d=A * W * math.cos(W * t), q1dd=-A * W * W * math.sin(W * t),
                           q2=B * math.sin(V * t), q2d=B * V * math.cos(V * t))


MOUNT = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
RIG = """
[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[limits]
speed_radps = 30.0
[calibration]
knee_zero_rad = 0.3
shunt_offset_a = 0.05
torque_constant_nm_per_a = 0.8
imu_mount = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
gyro_bias_radps = [0.01, -0.02, 0.03]
accel_bias_mps2 = [0.1, 0.2, -0.1]
"""


@pytest.fixture(scope="module")
def recorded(module_path: Path) -> tuple[Path, MockRig, int]:
    path = module_path / "r.mcap"
    rig = VirtualRig(MovingPlant(swing), ImuSettings(mount=MOUNT, gyro_bias_radps=(0.01, -0.02, 0.03),
                                                     accel_bias_mps2=(0.1, 0.2, -0.1), rate_error=-0.02),
                     FirmwareSettings(knee_zero_rad=0.3, shunt_offset_a=0.05, torque_constant_nm_per_a=0.8,
                                      first_tick_us=2**32 - 3_000_000), seed=3)
    start_ns = rig.clock.now_ns()
    t = np.arange(0, 6, 0.01)
    rig.open().save(path, RIG, Plan(t, 0.5 * np.sin(2 * np.pi * t)))
    return path, rig.mock, start_ns


def truth(run: Dataset, path: Path, start_ns: int) -> np.ndarray:
    epoch = int(read_run(path).streams["/leg/telemetry"]["host_ns"][0])
    return run.time_s + (epoch - start_ns) * 1e-9


def test_an_emulated_run_shows_the_motion_it_was_given(recorded: tuple[Path, MockRig, int]) -> None:
    path, _, start_ns = recorded
    run = load_run(path, parse_rig(RIG), 100.0)
    t = truth(run, path, start_ns)
    assert not run.gap().any() and 700 < len(run) < 760
    assert load_run(path, parse_rig(RIG)).rate_hz == pytest.approx(238.0, rel=0.03)  # the IMU's, by its own clock
    # allowed: noise after averaging, and a skew of 0.6 ms (link delay of 1 ms turns, physics in 0.5 ms steps) more
    # than that of the low passes at 238 Hz
    for column, want, noise, cutoff_hz in [
            ("q2_rad", B * np.sin(V * t), 4e-4, np.inf), ("q1_rad", A * np.sin(W * t), 3e-3, np.inf),
            ("gyro_radps", A * W * np.cos(W * t), 5e-3, 76.0),
            ("accel_x_mps2", -0.2 * A * W * W * np.sin(W * t) + 9.81 * np.sin(A * np.sin(W * t)), 0.05, 105.0),
            ("accel_y_mps2", -0.2 * (A * W * np.cos(W * t)) ** 2 - 9.81 * np.cos(A * np.sin(W * t)), 0.05, 105.0)]:
        error, slope = run[column] - want, np.gradient(want, t)
        skew = float(slope @ error / (slope @ slope))
        assert abs(skew + 1.0 / (2.0 * np.pi * cutoff_hz)) < 0.6e-3, column
        assert (error - skew * slope).std() < noise and abs(error.mean()) < noise / 2, column


def test_the_torque_is_what_acted(recorded: tuple[Path, MockRig, int]) -> None:
    path, rig, start_ns = recorded
    run = load_run(path, parse_rig(RIG))
    t_ns, _, acting = rig.firmware.motor.record
    fine = np.asarray(t_ns - start_ns + 250_000, float) * 1e-9
    want = align_table(RawTable("", fine, {"tau": acting}), 1000.0)
    t = truth(run, path, start_ns)
    mean = np.array([want["tau"][(want.time_s > x - 0.005) & (want.time_s < x + 0.005)].mean() for x in t])
    error = run["tau2_nm"] - mean
    assert error.std() < 0.02 and abs(error.mean()) < 0.002
    assert np.corrcoef(run["tau2_cmd_nm"], mean)[0, 1] > 0.99


def test_the_run_file_alone_is_enough_for_a_refit(recorded: tuple[Path, MockRig, int]) -> None:
    path, _, _ = recorded
    raw = read_run(path)
    rig = recorded_rig(raw)
    assert rig == parse_rig(RIG) and raw.files["plan.csv"].startswith("time_s,tau2_cmd_nm\n")
    assert {"calibration", "started_unix_ns", "version", "numpy"} <= set(raw.facts)
    assert {note.kind for note in raw.config} >= {"firmware", "imu"}
    run = load_run(path, rig, rate_hz=50.0)
    assert run.rate_hz == 50.0 and run.recorded_on == rig
    assert decode(raw, rig).clocks["controller clock"].startswith("+")


def test_a_cut_run_still_aligns_and_says_so(recorded: tuple[Path, MockRig, int], tmp_path: Path) -> None:
    path, _, _ = recorded
    data = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    run = load_run(tmp_path / "cut.mcap", parse_rig(RIG))
    assert len(run) > 150
    assert [damage.kind for damage in run.damage] == ["cut"] and "its end is missing" in run.damage[0].text


def test_runs_that_cannot_be_timed_are_refused(tmp_path: Path) -> None:
    rig = parse_rig(RIG)
    for count, said in ((0, "holds 0 telemetry samples"), (100, "no clock probe")):
        writer = RunWriter(tmp_path / f"{count}.mcap", {})
        for i in range(count):
            writer.add("/leg/telemetry", i, i * 2_000_000, 0.1, 0.1, 0.1, 0.0, 24.0, 30.0, 0.0, i * 2000, 5, i, 0, 0)
        writer.close()
        with pytest.raises(InputError, match=said):
            load_run(tmp_path / f"{count}.mcap", rig)


def test_a_reboot_in_mid_run_leaves_a_gap_and_keeps_the_time(tmp_path: Path) -> None:
    """Two boots with clocks of their own, the first wrapping; the knee's angle is the host's time."""
    writer = RunWriter(tmp_path / "b.mcap", {})

    def tick(t: float, start: float, first: float, error: float) -> int:
        return round(first + (t - start) * (1 + error) * 1e6) % 2**32

    for boot, stop, *clock in ((11, 4.0, 0.0, 2**32 - 1_500_000, 30e-6), (12, 9.0, 4.7, 0, -50e-6)):
        for k, t in enumerate(np.arange(clock[0], stop, 0.002)):
            host = round((t + 0.003 + 0.002 * (k % 5)) * 1e9)  # arrives late, in bursts
            writer.add("/leg/telemetry", host, host, t, np.nan, 0.0, 0.0, 24.0, 30.0, 0.0, tick(t, *clock), boot, k, 0,
                       1)
        for k, t in enumerate(np.arange(clock[0] + 0.1, stop, 0.25)):
            sent, back, ticks = round(t * 1e9), round((t + 0.0004) * 1e9), tick(t + 0.0002, *clock)
            writer.add("/leg/clock", back, sent, back, ticks, ticks, boot, k)
    writer.close()
    rig = parse_rig('[mechanism]\nmodel = "leg2"\nactuated = [2]\n')
    run = load_run(tmp_path / "b.mcap", rig)
    time_s, here = run.time_s + 0.003, ~run.gap()
    assert_allclose(run["q2_rad"][here], time_s[here], atol=5e-6)
    assert time_s[~here][[0, -1]] == pytest.approx([4.0, 4.7], abs=0.02) and "q1_rad" not in run
    assert "2 boots" in decode(read_run(tmp_path / "b.mcap"), rig).clocks["controller clock"]
