"""The driver: its bytes against the datasheet, and what it does when the bus or the chip misbehaves."""

import math
from typing import Any

import numpy as np
import pytest

from drivers import DeviceAbsent, DriverError, ImuConfig, Lsm9ds1, open_bus
from drivers.errors import DeviceBusy, DeviceFault
from tests.support.counted_chip import CountedChip


class Bench(CountedChip):
    """With its driver, and what that writes."""

    def __init__(self, config: ImuConfig | None = None, bus_khz: float = 400.0) -> None:
        super().__init__(range(1, 6), bus_khz)
        self.writes: list[bytes] = []
        transfer = self.chip.i2c_rdwr

        def spy(*messages) -> None:
            if len(messages) == 1:
                self.writes.append(bytes(messages[0]))
            transfer(*messages)

        self.chip.i2c_rdwr = spy
        self.driver = Lsm9ds1(self.chip, config=config, now_ns=self.clock.now_ns, sleep=self.clock.sleep,
                              bus_khz=bus_khz)

    def drain_for(self, seconds: float, every_s: float = 0.01) -> list:
        end, batches = self.clock.now_ns() + seconds * 1e9, []
        while self.clock.now_ns() < end:
            self.clock.sleep(every_s)
            batches.append(self.driver.drain())
        return batches


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.driver.open()
    return bench


@pytest.mark.parametrize("rate_hz, gyro_hz, accel_hz", [
    (14.9, 5.0, 408.0), (59.5, 19.0, 408.0), (119.0, 38.0, 50.0), (238.0, 76.0, 105.0), (476.0, 100.0, 211.0),
    (952.0, 100.0, 408.0)])
def test_low_passes_of_the_datasheet_where_its_registers_choose_none(rate_hz: float, gyro_hz: float, accel_hz: float
                                                                     ) -> None:
    config = ImuConfig(rate_hz)
    written = dict(config.registers())
    assert config.cutoffs_hz == (gyro_hz, accel_hz)
    assert written[0x11] == 0x00  # OUT_SEL: behind LPF1
    assert not written[0x20] & 0b111 and not written[0x10] & 0b11  # BW_SCAL_ODR, BW_XL, BW_G
    assert written[0x21] == 0x00  # no digital filter of the accelerometer


def test_configuration_bytes_of_the_datasheet() -> None:
    bench = Bench(ImuConfig(rate_hz=952.0, accel_range_g=16, gyro_range_dps=2000))
    bench.driver.open()
    written = {w[0]: w[1] for w in bench.writes}
    assert bench.writes[0] == b"\x22\x05"  # SW_RESET with the increment kept
    assert written[0x22] == 0x44  # BDU, IF_ADD_INC
    assert written[0x10] == 0b110_11_000  # 952 Hz, 2000 dps
    assert written[0x20] == 0b110_01_000  # 952 Hz, 16 g
    assert written[0x23] == 0x02  # FIFO_EN
    assert written[0x2E] == 0xC0  # continuous
    assert bench.writes[-1][0] == 0x2E


@pytest.mark.parametrize("gyro, accel, mdps, mg", [
    (245, 2, 8.75, 0.061), (500, 4, 17.5, 0.122), (2000, 8, 70.0, 0.244), (500, 16, 17.5, 0.732)])
def test_scales_are_the_datasheets(gyro: int, accel: int, mdps: float, mg: float) -> None:
    scale = ImuConfig(gyro_range_dps=gyro, accel_range_g=accel).scale
    assert scale == pytest.approx((mdps * 1e-3 * math.pi / 180, mg * 1e-3 * 9.80665), rel=1e-12)


@pytest.mark.parametrize("settings", [{"rate_hz": 200.0}, {"accel_range_g": 3}, {"gyro_range_dps": 1000}])
def test_settings_that_the_chip_lacks_are_refused(settings: dict) -> None:
    with pytest.raises(ValueError, match="LSM9DS1 has no"):
        ImuConfig(**settings)


def test_slow_bus_is_refused_before_anything_is_sent() -> None:
    bench = Bench(ImuConfig(rate_hz=952.0), bus_khz=100.0)
    with pytest.raises(ValueError, match=r"952 Hz needs 103 kbit/s.*100 kHz bus"):
        bench.driver.open()
    assert not bench.writes


@pytest.mark.parametrize("rate", [119.0, 238.0, 952.0])
def test_nothing_is_lost_or_doubled(rate: float) -> None:
    bench = Bench(ImuConfig(rate_hz=rate))
    bench.driver.open()
    batches = bench.drain_for(2.0)
    numbers = np.concatenate([b.raw[:, 0] for b in batches])
    assert len(numbers) == pytest.approx(2.0 * rate, rel=0.03)
    assert (np.diff(numbers) == 1).all()
    assert not any(b.gap_before for b in batches)
    assert [b.first_index for b in batches] == np.cumsum([0, *[len(b.raw) for b in batches[:-1]]]).tolist()
    assert numbers[0] >= 20  # settling samples are gone


def test_times_bound_the_newest_sample(bench: Bench) -> None:
    period, start = 1e9 / 238, bench.next_ns - bench.made * 1e9 / 238
    for batch in bench.drain_for(1.0):
        if len(batch.raw):
            latched = start + batch.raw[-1, 0] * period
            assert latched <= batch.t_after_ns
            assert latched + period >= batch.t_before_ns - 1000


def test_overrun_is_a_gap(bench: Bench) -> None:
    bench.drain_for(0.1)
    bench.clock.sleep(0.3)
    late = bench.driver.drain()
    assert len(late.raw) == 32
    assert late.gap_before
    assert late.reason == "FIFO overrun: drained too late"
    assert not bench.drain_for(0.1)[-1].gap_before


def test_a_stall_between_level_and_burst_is_a_gap(bench: Bench) -> None:
    bench.drain_for(0.1)
    bench.clock.sleep(0.1)
    transfer, calls = bench.chip.i2c_rdwr, []

    def stall(*messages) -> None:
        calls.append(messages)
        if len(messages) == 2 and messages[1].len > 12:
            bench.clock.sleep(0.06)  # the thread sleeps between the two transfers
        transfer(*messages)

    bench.chip.i2c_rdwr = stall
    batch = bench.driver.drain()
    assert batch.gap_before
    assert "stalled" in batch.reason


@pytest.mark.parametrize("after_bytes", [1, 12, 30])
def test_a_broken_burst_is_a_gap_and_is_never_read_twice(bench: Bench, after_bytes: int) -> None:
    before = np.concatenate([b.raw[:, 0] for b in bench.drain_for(0.1)])
    bench.clock.sleep(0.03)
    source = bench.chip.i2c_rdwr

    def break_the_burst(*messages) -> None:
        if len(messages) == 2 and messages[1].len > 24:
            bench.chip.fail(5, after_bytes=after_bytes)
            bench.chip.i2c_rdwr = source
        source(*messages)

    bench.chip.i2c_rdwr = break_the_burst
    batches = bench.drain_for(0.1, 0.02)
    numbers = np.concatenate([b.raw[:, 0] for b in batches])
    assert [b.reason for b in batches if b.gap_before] == ["burst broke off [errno 5]"]
    assert numbers[0] > before[-1]
    assert (np.diff(numbers) > 0).all()
    assert all(b.raw[:, 1:].tolist() == [[1, 2, 3, 4, 5]] * len(b.raw) for b in batches)


@pytest.mark.parametrize("errno", [121, 6, 5, 110, 11])
def test_passing_bus_errors_cost_nothing(bench: Bench, errno: int) -> None:
    bench.drain_for(0.05)
    bench.chip.fail(errno, times=3)  # the read of the fill level, three times
    batches = bench.drain_for(0.1)
    assert not any(b.gap_before for b in batches)


@pytest.mark.parametrize("trouble, seconds, reason", [
    (lambda chip: chip.fail(121, times=6), 0.2, "FIFO restarted"),
    (lambda chip: chip.brown_out(), 2.0, "configured anew")])
def test_longer_trouble_is_a_gap_after_which_the_chip_is_configured(bench: Bench, trouble: Any, seconds: float,
                                                                     reason: str) -> None:
    bench.drain_for(0.05)
    trouble(bench.chip)
    batches = bench.drain_for(seconds)
    (gap,) = [b for b in batches if b.gap_before]
    assert reason in gap.reason
    assert bench.chip.ranges == (500, 4)
    assert len(batches[-1].raw) and len(gap.raw)


@pytest.mark.parametrize("errno, kind, words", [
    (19, DeviceAbsent, "no device"), (121, DeviceAbsent, "no acknowledge"), (6, DeviceAbsent, "no device"),
    (5, DeviceAbsent, "bus error"), (110, DeviceAbsent, "held low"), (11, DeviceAbsent, "arbitration lost"),
    (16, DeviceBusy, "kernel driver"), (107, DeviceAbsent, "adapter is gone"),
    (95, DriverError, "no combined transfers"), (22, DriverError, "Errno 22")])
def test_errnos_are_said_in_words(errno: int, kind: type, words: str) -> None:
    bench = Bench()
    bench.chip.fail(errno, times=99)
    with pytest.raises(kind, match=words) as error:
        bench.driver.open()
    assert "LSM9DS1 at 0x6B" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_chip_that_stays_away_raises(bench: Bench) -> None:
    bench.chip.fail(121, times=99)
    with pytest.raises(DeviceAbsent, match="no acknowledge"):
        bench.drain_for(0.2)


def test_a_busy_chip_is_not_tried_again() -> None:
    bench = Bench()
    bench.chip.fail(16, times=1)
    with pytest.raises(DeviceBusy):
        bench.driver.open()


def test_another_chip_is_named_by_its_identity() -> None:
    bench = Bench()
    bench.chip._registers[0x0F] = 0x3D
    with pytest.raises(DeviceAbsent, match="WHO_AM_I reads 0x3D"):
        bench.driver.open()


def test_a_register_that_does_not_hold_is_a_fault() -> None:
    bench = Bench()
    store = bench.chip._store
    bench.chip._store = lambda register, value: store(register, value & 0x0F if register == 0x20 else value)
    with pytest.raises(DeviceFault, match="register 0x20"):
        bench.driver.open()


def test_a_chip_that_never_samples_is_a_fault() -> None:
    bench = Bench()
    bench.chip._advance = lambda t_ns: None
    with pytest.raises(DeviceFault, match="FIFO stays empty"):
        bench.driver.open()


def test_temperature_is_signed(bench: Bench) -> None:
    bench.chip.temperature_degc = 19.25
    assert bench.driver.temperature() == 19.25


def test_a_bus_that_is_not_there_is_said_in_words(tmp_path) -> None:
    with pytest.raises(DeviceAbsent, match="enable I2C"):
        open_bus(str(tmp_path / "i2c-9"))
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceAbsent, match="cannot be opened as an I2C bus"):
        open_bus(str(tmp_path / "file"))
