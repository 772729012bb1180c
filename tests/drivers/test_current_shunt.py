"""The current monitors: bytes against the data sheets and another driver, conversions, faults."""

import pytest

from drivers import CHIPS, CurrentShunt, DeviceAbsent
from drivers.current_shunt import AVERAGES, RAIL, STALE
from drivers.errors import DeviceFault
from drivers.mock import MockShunt, ShuntSettings, VirtualClock
from tests.support.circuitpython import Busio
from tests.support.spies import before

KINDS = sorted(CHIPS)


class Bench:
    """A shunt of 10 mOhm that carries `amperes` all the time."""

    def __init__(self, kind: str, rate_hz: float = 200.0) -> None:
        self.kind, self.clock, self.amperes = kind, VirtualClock(), 0.0
        self.chip = MockShunt(self.clock, lambda t_ns: self.amperes * t_ns * 1e-9, kind, ShuntSettings(noise_v=0.0))
        self.driver = CurrentShunt(self.chip, kind, 0.01, rate_hz, now_ns=self.clock.now_ns, sleep=self.clock.sleep)

    def read(self, amperes: float) -> tuple[float, int]:
        self.amperes = amperes
        self.clock.sleep(0.01)
        reading = self.driver.read()
        return reading.raw * self.driver.amperes_per_count, reading.flags


@pytest.fixture(params=KINDS)
def bench(request: pytest.FixtureRequest) -> Bench:
    """Open."""
    bench = Bench(request.param)
    bench.driver.open()
    return bench


@pytest.mark.parametrize("kind, words", [
    # 332 us, 4 averages: 1.328 ms; VSHCT = 010, AVG = 001, MODE = 101 and 540 us, 4 averages: VSHCT = 100, MODE = 1010
    ("ina226", {0x00: 0b0100_001_100_010_101}), ("ina228", {0x00: 0, 0x01: 0b1010_101_100_101_001, 0x0B: 0x8000})])
def test_what_is_written_is_the_data_sheets(kind: str, words: dict[int, int]) -> None:
    bench = Bench(kind, 400.0 if kind == "ina226" else 270.0)
    bench.driver.open()
    assert bench.chip._registers.items() >= words.items()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rate_hz", [10.0, 100.0, 250.0, 500.0, 1000.0])
def test_a_conversion_fits_between_two_readings_and_uses_much_of_the_time(kind: str, rate_hz: float) -> None:
    share = Bench(kind, rate_hz).driver.conversion_s * rate_hz
    assert 0.14 <= share <= 0.6


def test_a_rate_that_no_conversion_allows_is_refused() -> None:
    with pytest.raises(ValueError, match="INA226 cannot be read 5000 times a second; at most 4286"):
        Bench("ina226", 5000.0)


@pytest.mark.parametrize("amperes", [-7.9, -0.5, 0.0, 0.001, 2.5, 8.0])
def test_current_of_both_signs_is_read_to_a_count(bench: Bench, amperes: float) -> None:
    found, flags = bench.read(amperes)
    assert found == pytest.approx(amperes, abs=0.51 * CHIPS[bench.kind].volts_per_count / 0.01 + 1e-9) and not flags


@pytest.mark.parametrize("sign", [1, -1])
def test_a_current_beyond_the_range_is_marked(bench: Bench, sign: int) -> None:
    range_a = {"ina226": 8.19, "ina228": 16.38}[bench.kind]
    assert bench.driver.range_a == pytest.approx(range_a, abs=0.01)
    assert [bench.read(sign * share * range_a)[1] for share in (0.99, 1.01)] == [0, RAIL]


def test_a_reading_is_the_mean_over_its_conversion(bench: Bench) -> None:
    """A ramp is read as what it was half a conversion before the conversion's end, which is at most one before."""
    bench.chip._charge = lambda t_ns: 0.5 * (t_ns * 1e-9) ** 2  # a current of one ampere a second
    t = bench.driver.conversion_s
    for k in range(50):
        bench.clock.sleep(0.005 + 1e-5 * k)
        reading = bench.driver.read()
        late = reading.t_before_ns * 1e-9 - reading.raw * bench.driver.amperes_per_count
        assert 0.5 * t - 1e-3 <= late <= 1.5 * t + 1e-3


def test_a_chip_that_stops_converting_is_noticed_at_once(bench: Bench) -> None:
    assert bench.read(1.0)[1] == 0
    bench.chip.converting = False
    assert bench.read(1.0)[1] == STALE
    with pytest.raises(DeviceFault, match="converts nothing; power-cycle"):
        bench.driver.open()


def test_a_transfer_that_fails_between_flag_and_voltage_makes_nothing_stale(bench: Bench) -> None:
    bench.read(1.0)
    calls = []

    def second_fails(*messages: object) -> None:
        calls.append(messages)
        if len(calls) == 2:
            raise OSError(121, "injected")

    bench.clock.sleep(0.005)
    bench.driver._check_due_ns = 10**18
    before(bench.chip, "i2c_rdwr", second_fails)
    assert bench.driver.read().flags == 0 and len(calls) == 4


def test_silence_and_lost_settings_are_said_with_a_remedy(bench: Bench) -> None:
    bench.chip.fail(121, times=4)
    with pytest.raises(DeviceAbsent, match="at 0x40: no acknowledge; check wiring"):
        bench.driver.read()
    bench.chip.brown_out()
    bench.clock.sleep(0.2)
    with pytest.raises(DeviceFault, match="was written; check supply"):
        bench.driver.read()


@pytest.mark.parametrize("wired, said", [("ina226", "ina228"), ("ina228", "ina226")])
def test_the_other_chip_is_refused(wired: str, said: str) -> None:
    clock = VirtualClock()
    driver = CurrentShunt(MockShunt(clock, kind=wired), said, 0.01, 200.0, now_ns=clock.now_ns, sleep=clock.sleep)
    with pytest.raises(DeviceAbsent, match=r"correct \[devices.shunt\] kind or address"):
        driver.open()


def test_another_driver_reads_the_emulated_chip_as_ours_does() -> None:
    library = pytest.importorskip("adafruit_ina228")
    bench = Bench("ina228")
    theirs = library.INA228(Busio(bench.chip), skip_reset=True)
    assert theirs.device_id == 0x228
    bench.driver.open()
    bench.read(3.21)
    assert theirs.shunt_voltage == pytest.approx(3.21 * 0.01, abs=4e-7)
    assert list(AVERAGES) == library.AveragingCount._VALUES
    assert list(CHIPS["ina228"].conversion_us) == library.ConversionTime._VALUES
    us, averages = (library.ConversionTime._VALUES[theirs.shunt_voltage_conv_time],
                    library.AveragingCount._VALUES[theirs.averaging_count])
    assert us * averages * 1e-6 == pytest.approx(bench.driver.conversion_s)
    assert theirs.mode == library.Mode.CONT_SHUNT
