"""The driver: its bytes against the datasheet, and what it does when the bus or the chip misbehaves."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers import DeviceAbsent, DriverError, ImuConfig, Lsm9ds1, open_bus
from drivers.errors import DeviceBusy, DeviceFault
from tests.support.counted_chip import CountedChip
from tests.support.spies import before, recorded


class Bench(CountedChip):
    """With its driver, and what that writes."""

    def __init__(self, config: ImuConfig | None = None, bus_khz: float = 400.0) -> None:
        super().__init__(range(1, 6), bus_khz)
        self.calls = recorded(self.chip, "i2c_rdwr")
        self.driver = Lsm9ds1(self.chip, config=config, now_ns=self.clock.now_ns, sleep=self.clock.sleep,
                              bus_khz=bus_khz)

    def writes(self) -> list[bytes]:
        """Transfers of one message."""
        return [bytes(*messages) for messages in self.calls if len(messages) == 1]

    def drain_for(self, seconds: float, every_s: float = 0.01) -> list:
        end, batches = self.clock.now_ns() + seconds * 1e9, []
        while self.clock.now_ns() < end:
            self.clock.sleep(every_s)
            batches.append(self.driver.drain())
        return batches


def numbers_of(batches: list) -> np.ndarray:
    return np.concatenate([b.raw[:, 0] for b in batches])


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
    first, *_, last = writes = bench.writes()
    assert first == b"\x22\x05" and last[0] == 0x2E  # SW_RESET with the increment kept
    assert {w[0]: w[1] for w in writes}.items() >= {
        0x22: 0x44,  # BDU, IF_ADD_INC
        0x10: 0b110_11_000,  # 952 Hz, 2000 dps
        0x20: 0b110_01_000,  # 952 Hz, 16 g
        0x23: 0x02,  # FIFO_EN
        0x2E: 0xC0}.items()  # continuous


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
    assert not bench.writes()


@pytest.mark.parametrize("rate", [119.0, 238.0, 952.0])
def test_nothing_is_lost_or_doubled(rate: float) -> None:
    bench = Bench(ImuConfig(rate_hz=rate))
    bench.driver.open()
    batches = bench.drain_for(2.0)
    numbers = numbers_of(batches)
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
            assert batch.t_before_ns - 1000 - period <= latched <= batch.t_after_ns


def test_overrun_is_a_gap(bench: Bench) -> None:
    bench.drain_for(0.1)
    bench.clock.sleep(0.3)
    late = bench.driver.drain()
    assert (len(late.raw), late.gap_before, late.reason) == (32, True, "FIFO overrun: drained too late")
    assert not bench.drain_for(0.1)[-1].gap_before


def test_a_stall_between_level_and_burst_is_a_gap(bench: Bench) -> None:
    bench.drain_for(0.1)
    bench.clock.sleep(0.1)

    def stall(*messages) -> None:
        if len(messages) == 2 and messages[1].len > 12:
            bench.clock.sleep(0.06)  # the thread sleeps between the two transfers

    before(bench.chip, "i2c_rdwr", stall)
    batch = bench.driver.drain()
    assert batch.gap_before and "stalled" in batch.reason


@pytest.mark.parametrize("after_bytes", [1, 12, 30])
def test_a_broken_burst_is_a_gap_and_is_never_read_twice(bench: Bench, after_bytes: int) -> None:
    last = numbers_of(bench.drain_for(0.1))[-1]
    bench.clock.sleep(0.03)
    source = bench.chip.i2c_rdwr

    def break_the_burst(*messages) -> None:
        if len(messages) == 2 and messages[1].len > 24:
            bench.chip.fail(5, after_bytes=after_bytes)
            bench.chip.i2c_rdwr = source

    before(bench.chip, "i2c_rdwr", break_the_burst)
    batches = bench.drain_for(0.1, 0.02)
    assert [b.reason for b in batches if b.gap_before] == ["burst broke off [errno 5]"]
    assert (np.diff(numbers_of(batches), prepend=last) > 0).all()


@pytest.mark.parametrize("errno", [121, 6, 5, 110, 11])
def test_passing_bus_errors_cost_nothing(bench: Bench, errno: int) -> None:
    bench.drain_for(0.05)
    bench.chip.fail(errno, times=3)  # the read of the fill level, three times
    assert not any(b.gap_before for b in bench.drain_for(0.1))


@pytest.mark.parametrize("trouble, seconds, reason", [
    (lambda chip: chip.fail(121, times=6), 0.2, "FIFO restarted"),
    (lambda chip: chip.brown_out(), 2.0, "configured anew")])
def test_longer_trouble_is_a_gap_after_which_the_chip_is_configured(bench: Bench, trouble: Any, seconds: float,
                                                                     reason: str) -> None:
    bench.drain_for(0.05)
    trouble(bench.chip)
    batches = bench.drain_for(seconds)
    (gap,) = [b for b in batches if b.gap_before]
    assert reason in gap.reason and bench.chip.ranges == (500, 4)
    assert len(batches[-1].raw) and len(gap.raw)


@pytest.mark.parametrize("errno, kind, words", [
    (19, DeviceAbsent, "no device"), (121, DeviceAbsent, "no acknowledge"), (6, DeviceAbsent, "no device"),
    (5, DeviceAbsent, "bus error"), (110, DeviceAbsent, "held low"), (11, DeviceAbsent, "arbitration lost"),
    (16, DeviceBusy, "kernel driver"), (107, DeviceAbsent, "adapter is gone"),
    (95, DriverError, "no combined transfers"), (22, DriverError, "Errno 22")])
def test_errnos_are_said_in_words(errno: int, kind: type, words: str) -> None:
    """A busy chip is not tried again."""
    bench = Bench()
    bench.chip.fail(errno, times=1 if kind is DeviceBusy else 99)
    with pytest.raises(kind, match=words) as error:
        bench.driver.open()
    assert "LSM9DS1 at 0x6B" in str(error.value) and "\n" not in str(error.value)


def test_a_chip_that_stays_away_raises(bench: Bench) -> None:
    bench.chip.fail(121, times=99)
    with pytest.raises(DeviceAbsent, match="no acknowledge"):
        bench.drain_for(0.2)


def lets_go_of_0x20(bench: Bench) -> None:
    store = bench.chip._store
    bench.chip._store = lambda register, value: store(register, value & 0x0F if register == 0x20 else value)


@pytest.mark.parametrize("spoil, kind, words", [
    (lambda bench: bench.chip._registers.__setitem__(0x0F, 0x3D), DeviceAbsent, "WHO_AM_I reads 0x3D"),
    (lets_go_of_0x20, DeviceFault, "register 0x20"),
    (lambda bench: setattr(bench.chip, "_advance", lambda t_ns: None), DeviceFault, "FIFO stays empty")])
def test_another_chip_and_one_that_keeps_no_register_or_never_samples_are_named(
        spoil: Callable[[Bench], None], kind: type[Exception], words: str) -> None:
    bench = Bench()
    spoil(bench)
    with pytest.raises(kind, match=words):
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
