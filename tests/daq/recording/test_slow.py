"""Temperature and magnetic field beside the fast samples: recorded raw, put into the link's frame by the rig."""

from pathlib import Path

import numpy as np
import pytest

from daq.recording import Plan
from daq.runs import read_run
from drivers import TO_AG, Magnetometer
from drivers.mock.chip import MockBus
from experiments.reports import describe_mcap
from tests.support.mock_magnetometer import MockMagnetometer
from tests.support.processes import REAL_CLOCK
from tests.support.virtual_rig import VirtualRig

pytestmark = REAL_CLOCK

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.imu]\nslow_hz = 10.0\nmagnetometer = 0x1E\n'


def test_temperature_and_field_are_recorded_and_a_silent_magnetometer_stops_nothing(path: Path) -> None:
    rig = VirtualRig()
    chip = MockMagnetometer(rig.clock)
    rig.imu.bus = MockBus([rig.mock.imu, chip])
    rig.open()
    rig.imu.magnetometer = Magnetometer(rig.imu.bus, **rig.times)
    rig.imu.magnetometer.open()
    chip.field_gauss = (0.25, -0.1, 0.43)

    def happens(now_s: float, _: float) -> None:
        rig.mock.imu.temperature_degc = 31.0 + now_s
        if 1.0 < now_s < 1.03:
            chip.fail(121)

    t = np.arange(0.0, 3.0, 0.01)
    rig.save(path, RIG, Plan(t, 0 * t), progress=happens)
    raw = read_run(path)
    slow, imu = raw.streams["/imu/slow"], raw.streams["/imu"]
    assert 30 <= slow.size <= 45
    assert slow["temperature_degc"].max() == pytest.approx(34.0, abs=0.2)
    seen = slow[slow["field_valid"] == 1]
    assert seen.size > 25
    counts = np.column_stack([seen[f"field_{axis}"] for axis in "xyz"])
    # 0.14 mG a count at 4 gauss; 1 gauss is 1e-4 T; the magnetometer's X opposes the other sensors'
    np.testing.assert_allclose(counts * 0.14e-7 * TO_AG,
                               np.tile([-0.25e-4, -0.1e-4, 0.43e-4], (seen.size, 1)), atol=1e-8)
    assert (np.diff(imu["index"].astype(int)) == 1).all() and imu["gap_before"].sum() == 0
    assert "chip temperature: 31.0 to 3" in describe_mcap(raw)
