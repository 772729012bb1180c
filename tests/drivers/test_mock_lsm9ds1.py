"""The emulated chip against the datasheet, at the level of bytes on the wire."""

import math

import numpy as np
import pytest
from smbus2 import i2c_msg

from drivers.mock import ImuSettings, MockRig, Plant, VirtualClock
from drivers.mock.lsm9ds1 import MockLsm9ds1
from tests.support.still_plant import MovingPlant, StillPlant, StillState

ADDRESS = 0x6B
RADPS_A_COUNT, MPS2_A_COUNT = math.radians(0.0175), 0.122e-3 * 9.80665
"""At 500 dps and 4 g."""


class Wire:
    """A chip and the two transfers that a host makes."""

    def __init__(self, chip: MockLsm9ds1) -> None:
        self.chip = chip

    def read(self, register: int, count: int = 1) -> bytes:
        reply = i2c_msg.read(ADDRESS, count)
        self.chip.i2c_rdwr(i2c_msg.write(ADDRESS, [register]), reply)
        return bytes(reply)

    def write(self, register: int, *values: int) -> None:
        self.chip.i2c_rdwr(i2c_msg.write(ADDRESS, [register, *values]))


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def wire(clock: VirtualClock) -> Wire:
    return Wire(MockLsm9ds1(clock))


def start_fifo(wire: Wire, mode: int = 0xC0) -> None:
    wire.write(0x10, 0x88)  # 238 Hz, 500 dps
    wire.write(0x23, 0x02)
    wire.write(0x2E, mode)


def push(wire: Wire, count: int) -> None:
    for k in range(count):
        wire.chip.push(sample(k))


def level(wire: Wire) -> int:
    """FIFO_SRC without its threshold flag."""
    return wire.read(0x2F)[0] & 0x7F


def sample(k: int) -> list[int]:
    return [k, -k, 100 + k, 1000 + k, -1000 - k, k]


def samples(wire: Wire, count: int) -> np.ndarray:
    return np.frombuffer(wire.read(0x18, 12 * count), "<i2").reshape(count, 6)


def test_defaults_after_power_up_and_the_identity_is_read_only(wire: Wire) -> None:
    wire.write(0x0F, 0x00)
    defaults = {0x0F: 0x68, 0x10: 0x00, 0x1E: 0x38, 0x1F: 0x38, 0x20: 0x00, 0x22: 0x04, 0x23: 0x00, 0x2E: 0x00}
    assert {r: wire.read(r)[0] for r in defaults} == defaults


def test_another_address_is_not_acknowledged(wire: Wire) -> None:
    with pytest.raises(OSError) as error:
        wire.chip.i2c_rdwr(i2c_msg.write(0x1E, [0x0F]), i2c_msg.read(0x1E, 1))
    assert error.value.errno == 121


def test_software_reset_restores_defaults_and_clears_itself(wire: Wire, clock: VirtualClock) -> None:
    start_fifo(wire)
    wire.write(0x22, 0x05)
    assert wire.read(0x22)[0] & 0x01
    clock.sleep(0.001)
    assert wire.read(0x22) + wire.read(0x10) == b"\x04\x00"


def test_accelerometer_takes_the_gyro_rate(wire: Wire) -> None:
    wire.write(0x20, 0x30)  # 10 Hz code, 4 g
    wire.write(0x10, 0xA0)  # 476 Hz
    assert wire.read(0x20) == b"\xb0"


def test_without_auto_increment_one_register_repeats(wire: Wire) -> None:
    wire.write(0x22, 0x00)
    assert wire.read(0x0F, 3) == b"\x68\x68\x68"


def test_burst_jumps_1d_to_28_and_wraps_2d_to_18(wire: Wire) -> None:
    start_fifo(wire)
    push(wire, 3)
    assert samples(wire, 3).tolist() == [sample(0), sample(1), sample(2)] and level(wire) == 0


def test_fifo_source_counts_to_32_and_reports_overrun_only_after_an_overwrite(wire: Wire) -> None:
    start_fifo(wire)
    push(wire, 32)
    assert level(wire) == 0x20
    wire.chip.push(sample(32))
    assert level(wire) == 0x60
    assert samples(wire, 1).tolist() == [sample(1)]  # the oldest went
    assert level(wire) == 31


def test_threshold_flag(wire: Wire) -> None:
    start_fifo(wire, 0xC0 | 2)
    for flag in (0, 0x80):
        wire.chip.push(sample(0))
        assert wire.read(0x2F)[0] & 0x80 == flag


def test_fifo_mode_stops_when_full_and_bypass_empties(wire: Wire) -> None:
    start_fifo(wire, 0x20)
    push(wire, 40)
    assert level(wire) == 0x20
    assert samples(wire, 1).tolist() == [sample(0)]
    wire.write(0x2E, 0x00)
    assert level(wire) == 0


def test_temperature_is_16_lsb_per_degree_from_25(wire: Wire) -> None:
    wire.chip.temperature_degc = 20.5  # -4.5 * 16 = -72 = 0xFFB8
    assert wire.read(0x15, 2) == b"\xb8\xff"


def test_time_on_the_wire(wire: Wire, clock: VirtualClock) -> None:
    before = clock.now_ns()
    wire.read(0x18, 384)  # 1 + 1 + 1 + 384 bytes of 9 bits at 400 kHz
    assert clock.now_ns() - before == pytest.approx(387 * 9 / 400e3 * 1e9, abs=1e3)


def samples_of(plant: Plant, settings: ImuSettings, seconds: float, xl: int = 0x90, gyro: int = 0x88) -> np.ndarray:
    clock = VirtualClock()
    rig = MockRig(plant, clock, imu=settings)
    wire = Wire(rig.imu)
    wire.write(0x10, gyro)
    wire.write(0x20, xl)
    wire.write(0x23, 0x02)
    wire.write(0x2E, 0xC0)
    out, end = [], clock.now_ns() + seconds * 1e9
    while clock.now_ns() < end:
        clock.sleep(0.015)
        out.append(samples(wire, level(wire) & 0x3F))
    return np.vstack(out).astype(float)


def test_physics_geometry_scale_and_bias() -> None:
    state = StillState(q1=0.4, q1d=1.5, q1dd=-3.0)
    settings = ImuSettings(lever_arm_m=0.25, gravity_mps2=9.81, gyro_bias_radps=(0.0, 0.0, 0.1), rate_error=0.0)
    mean = samples_of(StillPlant(state), settings, 4.0).mean(axis=0)
    a_x = 0.25 * -3.0 + 9.81 * math.sin(0.4)
    a_y = -0.25 * 1.5**2 - 9.81 * math.cos(0.4)
    assert mean == pytest.approx([0, 0, 1.6 / RADPS_A_COUNT, a_x / MPS2_A_COUNT, a_y / MPS2_A_COUNT, 0], abs=8.0)


def test_mount_turns_contract_axes_into_the_chips() -> None:
    # contract x = chip y, contract y = chip -x, contract z = chip z
    mount = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    mean = samples_of(StillPlant(StillState(q1=math.pi / 6)), ImuSettings(mount=mount), 2.0).mean(axis=0)
    assert mean[3:] * MPS2_A_COUNT == pytest.approx([9.81 * math.cos(math.pi / 6), 9.81 * 0.5, 0.0], abs=0.02)


def test_noise_and_rate_error_are_what_was_asked_for() -> None:
    raw = samples_of(StillPlant(), ImuSettings(gyro_noise_radps=0.02, accel_noise_mps2=0.1, rate_error=0.05), 8.0)
    assert len(raw) == pytest.approx(8.0 * 238 * 1.05, rel=0.01)
    std = raw.std(axis=0) * np.repeat([RADPS_A_COUNT, MPS2_A_COUNT], 3)
    assert std == pytest.approx(np.repeat([0.02, 0.1], 3), rel=0.08)


def test_clips_at_full_scale() -> None:
    raw = samples_of(StillPlant(StillState(q1d=30.0)), ImuSettings(), 0.3, xl=0x80, gyro=0x80)  # 245 dps, 2 g
    assert set(raw[:, 2]) == {32767.0}
    assert set(raw[:, 4]) == {-32768.0}


def test_same_seed_same_samples() -> None:
    one, other = (samples_of(StillPlant(), ImuSettings(), 0.3) for _ in range(2))
    assert np.array_equal(one, other)


def ramp(t: float) -> StillState:
    """Speed and acceleration both grow evenly, from 0.3 s on."""
    since = max(t - 0.3, 0.0)
    return StillState(q1d=8.0 * since, q1dd=100.0 * since)


@pytest.mark.parametrize("gyro, gyro_hz, accel_hz", [
    (0x68, 38.0, 50.0), (0x88, 76.0, 105.0), (0xA8, 100.0, 211.0)])
def test_readings_of_a_ramp_lag_by_the_time_constants_of_the_low_passes(gyro: int, gyro_hz: float, accel_hz: float
                                                                        ) -> None:
    quiet = ImuSettings(gyro_noise_radps=0.0, accel_noise_mps2=0.0, lever_arm_m=0.2, gravity_mps2=0.0)
    found = samples_of(MovingPlant(ramp), quiet, 0.9, gyro=gyro)[-20:]
    speed, across = found[:, 2] * RADPS_A_COUNT, found[:, 3] * MPS2_A_COUNT
    later_s = across / (0.2 * 100.0) - speed / 8.0  # by which the gyro's ramp is behind the accelerometer's
    want = 1.0 / (2.0 * np.pi * gyro_hz) - 1.0 / (2.0 * np.pi * accel_hz)
    assert later_s.mean() == pytest.approx(want, abs=2e-5)
