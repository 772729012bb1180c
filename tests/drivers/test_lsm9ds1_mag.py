"""Magnetometer and self-test: bytes against the datasheet, limits against ST's example, faults said in words."""

from typing import Any

import numpy as np
import pytest
from smbus2 import i2c_msg

from drivers import TO_AG, DeviceAbsent, Lsm9ds1, MagConfig, Magnetometer, SelfTest
from drivers.errors import DeviceFault
from drivers.mock import VirtualClock
from drivers.mock.chip import MockBus
from drivers.mock.lsm9ds1 import MockLsm9ds1
from tests.support.mock_magnetometer import MockMagnetometer
from tests.support.spies import before


class Bench:
    """Both chips of an LSM9DS1 on one bus; the inertial one reads a constant."""

    def __init__(self, config: MagConfig | None = None) -> None:
        self.clock = VirtualClock()
        self.mag = MockMagnetometer(self.clock)
        self.ag = MockLsm9ds1(self.clock, advance=self.advance)
        self.bus = MockBus([self.mag, self.ag])
        self.next_ns = 0.0
        self.times: dict[str, Any] = {"now_ns": self.clock.now_ns, "sleep": self.clock.sleep}
        self.driver = Magnetometer(self.bus, config=config, **self.times)
        self.self_test = SelfTest(self.bus, self.clock.sleep, self.clock.now_ns)

    def advance(self, t_ns: int) -> None:
        self.next_ns = self.next_ns or t_ns
        while self.ag.rate_hz and self.next_ns <= t_ns:
            self.ag.push([30, -40, 50, 100, -200, 16393])
            self.next_ns += 1e9 / self.ag.rate_hz

    def byte(self, address: int, register: int) -> int:
        reply = i2c_msg.read(address, 1)
        self.bus.i2c_rdwr(i2c_msg.write(address, [register]), reply)
        return bytes(reply)[0]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def opened(config: MagConfig | None = None) -> Bench:
    bench = Bench(config)
    bench.driver.open()
    return bench


def test_configuration_bytes_of_the_datasheet() -> None:
    bench = opened(MagConfig(80.0, 12))
    assert [bench.byte(0x1E, register) for register in range(0x20, 0x25)] == [
        0b1_11_111_0_0,  # temperature compensated, ultra-high X Y, 80 Hz
        0b0_10_00000,  # 12 gauss
        0x00,  # continuous conversion
        0b0000_11_00,  # ultra-high Z
        0x40]  # block data update


@pytest.mark.parametrize("gauss, mgauss", [(4, 0.14), (8, 0.29), (12, 0.43), (16, 0.58)])
def test_field_in_tesla_and_x_turned_to_the_other_sensors(gauss: int, mgauss: float) -> None:
    bench = opened(MagConfig(20.0, gauss))
    bench.mag.field_gauss = (0.25, -0.1, 0.43)
    bench.clock.sleep(0.051)
    sample = bench.driver.read()
    np.testing.assert_allclose(sample.raw, np.array([250, -100, 430]) / mgauss, atol=0.51)
    field_t = sample.raw * bench.driver.config.scale_t * TO_AG
    np.testing.assert_allclose(field_t, [-0.25e-4, -0.1e-4, 0.43e-4], atol=mgauss * 0.51e-7)


@pytest.mark.parametrize("rate", [0.625, 1.25, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0])
def test_every_rate_gives_each_reading_once(rate: float) -> None:
    bench = opened(MagConfig(rate))
    got, end = 0, bench.clock.now_ns() + 20 / rate * 1e9
    while bench.clock.now_ns() < end:
        bench.clock.sleep(0.3 / rate)
        sample = bench.driver.read()
        got += sample is not None
        assert sample is None or not sample.overrun
    assert got == pytest.approx(20, abs=1)


def test_an_unread_reading_is_said_to_be_lost() -> None:
    bench = opened()
    bench.clock.sleep(0.4)
    assert bench.driver.read().overrun


@pytest.mark.parametrize("settings", [{"rate_hz": 100.0}, {"range_gauss": 2}])
def test_settings_that_the_chip_lacks_are_refused(settings: dict) -> None:
    with pytest.raises(ValueError, match="magnetometer has no"):
        MagConfig(**settings)


def test_another_chip_and_an_absent_one_are_named(bench: Bench) -> None:
    for address, said in ((0x1C, "0x1C: no acknowledge"), (0x6B, "WHO_AM_I reads 0x68")):
        with pytest.raises(DeviceAbsent, match=said):
            Magnetometer(bench.bus, address, **bench.times).open()
    bench.driver.open()
    bench.mag.fail(121, 1)
    with pytest.raises(DeviceAbsent, match="no acknowledge"):
        bench.driver.read()


def test_a_register_that_does_not_hold_is_a_fault(bench: Bench) -> None:
    store = bench.mag._store
    bench.mag._store = lambda register, value: store(register, 0 if register == 0x24 else value)
    with pytest.raises(DeviceFault, match="register 0x24"):
        bench.driver.open()


def test_a_sound_chip_passes_its_self_test(bench: Bench) -> None:
    accel, gyro = bench.self_test.inertial()
    assert bench.byte(0x6B, 0x24) == 0  # the deflection is off again
    magnetic = bench.self_test.magnetic()
    assert bench.byte(0x1E, 0x20) & 1 == 0
    for found, moved in ((accel, (400.0,) * 3), (gyro, (500.0,) * 3), (magnetic, (2000.0, 2000.0, 500.0))):
        assert found.passed and found.moved == pytest.approx(moved, abs=0.5 if found is magnetic else 0.1)
    assert "magnetometer passed" in str(magnetic)


@pytest.mark.parametrize("mg, dps, broken", [(69.0, 500.0, "accel"), (1501.0, 500.0, "accel"),
                                                   (400.0, 199.0, "gyro"), (400.0, 801.0, "gyro")])
def test_limits_are_those_of_the_makers_example(bench: Bench, mg: float, dps: float, broken: str) -> None:
    bench.ag.self_test_mg, bench.ag.self_test_dps = mg, dps
    accel, gyro = bench.self_test.inertial()
    assert (accel.passed, gyro.passed) == (broken != "accel", broken != "gyro")
    assert "FAILED" in str(accel if broken == "accel" else gyro)


@pytest.mark.parametrize("moved", [(999.0, 2000.0, 500.0), (2000.0, 3001.0, 500.0), (2000.0, 2000.0, 99.0),
                                   (2000.0, 2000.0, 1001.0)])
def test_limits_of_the_magnetometer(bench: Bench, moved: tuple[float, float, float]) -> None:
    bench.mag.self_test_mgauss = moved
    assert not bench.self_test.magnetic().passed


def test_a_chip_that_measures_nothing_is_a_fault_and_the_deflection_goes_off(bench: Bench) -> None:
    bench.ag._advance = lambda t_ns: None
    with pytest.raises(DeviceFault, match="no new reading"):
        bench.self_test.inertial()
    assert bench.byte(0x6B, 0x24) == 0


def test_after_the_self_test_the_driver_configures_everything_anew(bench: Bench) -> None:
    bench.self_test.inertial()
    driver = Lsm9ds1(bench.bus, **bench.times)
    driver.open()
    bench.clock.sleep(0.05)
    raw = driver.drain().raw
    assert len(raw) > 5 and (raw == [30, -40, 50, 100, -200, 16393]).all()


def away(bench: Bench, seconds: float) -> list:
    """The batches around a time in which the chip answers nothing."""
    driver = Lsm9ds1(bench.ag, **bench.times)
    driver.open()
    back = bench.clock.now_ns() + round(seconds * 1e9)

    def gone(*messages) -> None:
        if bench.clock.now_ns() < back:
            raise OSError(121, "no acknowledge")

    before(bench.ag, "i2c_rdwr", gone)
    batches = []
    while bench.clock.now_ns() < back + 300_000_000:
        bench.clock.sleep(0.01)
        batches.append(driver.drain())
    return batches


def test_a_chip_away_for_a_moment_is_reset_and_reads_on_after_one_gap(bench: Bench) -> None:
    batches = away(bench, 0.08)
    (gap,) = [b for b in batches if b.gap_before]
    assert len(gap.raw) and len(batches[-1].raw)
    assert bench.byte(0x6B, 0x10) == 0b100_01_000  # 238 Hz, 500 dps: configured again


def test_a_chip_away_for_good_is_said_to_be_gone(bench: Bench) -> None:
    with pytest.raises(DeviceAbsent, match="no acknowledge"):
        away(bench, 5.0)
