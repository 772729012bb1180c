"""The pivot sensor: its bytes against the data sheet and another driver, and what it says when something is wrong."""

import math

import pytest

from drivers import As5600, DeviceAbsent
from drivers.as5600 import COUNTS, MD, MH, ML
from drivers.errors import DeviceFault
from drivers.mock import MockAs5600, PivotSettings, VirtualClock
from tests.support.circuitpython import Busio
from tests.support.spies import recorded


class Bench:
    def __init__(self) -> None:
        self.clock, self.angle = VirtualClock(), 0.0
        self.chip = MockAs5600(self.clock, lambda t_ns: self.angle, PivotSettings(noise_rad=0.0))
        self.driver = As5600(self.chip, now_ns=self.clock.now_ns, sleep=self.clock.sleep)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def opened(bench: Bench) -> Bench:
    bench.driver.open()
    return bench


def test_what_is_written_and_read_is_the_data_sheets(bench: Bench) -> None:
    calls = recorded(bench.chip, "i2c_rdwr")
    bench.driver.open()
    sent = [[bytes(x) for x in messages if not x.flags & 1] for messages in calls]
    assert [b"\x07\x03"] in sent and [b"\x08\x00"] in sent  # CONF: SF = 11, FTH = 000, PM, HYST, WD off
    assert not any(message[0][0] == 0xFF for message in sent)  # never the burn register
    assert [b"\x0c"] in sent and [b"\x0b"] in sent  # RAW ANGLE and STATUS


def test_every_angle_is_read_as_its_count_all_round(opened: Bench) -> None:
    for count in range(0, COUNTS, 37):
        opened.angle = count * 2 * math.pi / COUNTS - 4 * math.pi
        assert opened.driver.read().raw == count


def test_a_reading_is_stamped_around_its_transfer(opened: Bench) -> None:
    before = opened.clock.now_ns()
    reading = opened.driver.read()
    assert before <= reading.t_before_ns < reading.t_after_ns <= opened.clock.now_ns()
    assert reading.t_after_ns - reading.t_before_ns == pytest.approx(5 * 9 / 400e3 * 1e9, abs=10)  # 5 bytes at 400 kHz


@pytest.mark.parametrize("name, value, error, line", [
    ("status", 0, DeviceFault, "no magnet"), ("status", ML, DeviceFault, "no magnet"),
    ("status", MD | ML | MH, DeviceFault, "cannot be true"),
    ("held_at", 0xFF, DeviceAbsent, "another chip is wired there")])
def test_a_magnet_that_is_not_there_and_another_chip_are_refused_with_a_remedy(
        bench: Bench, name: str, value: int, error: type[Exception], line: str) -> None:
    setattr(bench.chip, name, value)
    with pytest.raises(error, match=line):
        bench.driver.open()


@pytest.mark.parametrize("status, valid", [(MD, True), (MD | ML, True), (MD | MH, True), (0, False), (0xFF, False)])
def test_a_reading_is_valid_where_there_is_a_magnet(opened: Bench, status: int, valid: bool) -> None:
    opened.chip.status = status
    assert opened.driver.read().valid is valid


def test_the_gain_is_read_now_and_then(bench: Bench) -> None:
    assert bench.driver.open().agc == 64
    bench.chip.status = MD | ML
    bench.clock.sleep(0.2)
    assert bench.driver.read().agc == 128


def test_three_failures_are_borne_and_a_fourth_is_said(opened: Bench) -> None:
    opened.chip.fail(121, times=3)
    assert opened.driver.read().valid
    opened.chip.fail(121, times=4)
    with pytest.raises(DeviceAbsent, match="AS5600 at 0x36: no acknowledge; check wiring"):
        opened.driver.read()


def test_lost_settings_are_noticed_within_a_tenth_of_a_second(opened: Bench) -> None:
    opened.chip.brown_out()
    with pytest.raises(DeviceFault, match=r"CONF reads 0x0000 after 0x0300 was written; check supply"):
        for _ in range(21):
            opened.clock.sleep(0.005)
            opened.driver.read()


def test_another_driver_reads_the_emulated_chip_as_ours_does(bench: Bench) -> None:
    library = pytest.importorskip("adafruit_as5600")
    bench.angle = 1.234
    ours = bench.driver.open()
    theirs = library.AS5600(Busio(bench.chip))
    assert theirs.raw_angle == ours.raw == round(1.234 / (2 * math.pi) * 4096)
    assert theirs.magnet_detected and not theirs.max_gain_overflow and not theirs.min_gain_overflow
    assert theirs.agc == ours.agc and theirs.magnitude == ours.magnitude and theirs.zm_count == 0
    bench.driver.open()
    assert theirs.slow_filter == 3 and theirs.fast_filter_threshold == 0 and not theirs.watchdog
    assert theirs.power_mode == 0 and theirs.hysteresis == 0
