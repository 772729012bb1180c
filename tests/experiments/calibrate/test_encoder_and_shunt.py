"""`legid calibrate encoder` and `shunt`: against closed forms, and stops of a simulated leg."""

from pathlib import Path

import numpy as np
import pytest

from daq import WorkError, load_rig
from daq.calibration import Stop, friction_cone, hanging_zero, straight_zero
from daq.runs import BLOCKS, Mean, mean_of
from drivers.mock import FirmwareSettings, MockRig, PtyServer
from experiments.emulation import LegBody
from experiments.emulation.plant import LegPlant
from tests.support.models import LEG, write_model
from tests.support.motor_off_runs import RIG, TELEMETRY_HZ, hanging, write_off
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Answers, Shell
from tests.support.still_plant import StillPlant, StillState

pytestmark = REAL_CLOCK

G = 9.81


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


# -- intervals ---------------------------------------------------------------------------------------------------

def test_block_means_cover_a_coloured_mean_and_know_a_drift() -> None:
    covered, drifted, kept = 0, 0, 300
    for seed in range(kept):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(4020)
        coloured = np.convolve(noise, np.ones(20) / 20, "valid")  # its samples are 20 times worth less
        found = mean_of(3.0 + coloured[:4000])
        covered += abs(found.value - 3.0) < found.half
        drifted += found.drifts
        sloped = mean_of(3.0 + coloured[:4000] + np.linspace(-0.2, 0.2, 4000))
        assert abs(sloped.drift - 0.4) < 3 * sloped.drift_half
    assert 0.90 < covered / kept < 0.985
    assert drifted / kept < 0.09
    assert sloped.drifts


def stop(value: float) -> Stop:
    return Stop("s", Mean(value, 1e-5, 0.0, 1e-5), Mean(0.0, 0.0, 0.0, 0.0))


def test_stops_spread_evenly_are_covered_in_95_of_100_cases() -> None:
    rng = np.random.default_rng(7)
    for count in (4, 6, 10):
        inside = 0
        for _ in range(5000):
            found = hanging_zero([stop(v) for v in 0.3 + rng.uniform(-0.01, 0.01, count)], None)
            inside += abs(found.value - 0.3) < found.half
        assert inside / 5000 == pytest.approx(0.95, abs=0.015), count


def test_a_known_cone_bounds_the_zero_and_is_contradicted_by_stops_too_far_apart() -> None:
    found = hanging_zero([stop(0.31), stop(0.27)], 0.03)
    assert (found.value, found.half) == pytest.approx((0.29, 0.01), abs=1e-4)  # 0.31 - 0.03 .. 0.27 + 0.03
    assert friction_cone(0.05, 0.1, G) == pytest.approx(np.arcsin(0.05 / 0.981))
    with pytest.raises(WorkError, match="at any angle"):
        friction_cone(1.2, 0.1, G)
    for values, cone, said in (((0.34, 0.27), 0.03, "sticks more than it slides"),
                               ((0.3, 0.31, 0.29), None, "3 stops and no known friction"),
                               ((0.0, 0.2, 0.1, 0.4), None, "too uncertain to use")):
        with pytest.raises(WorkError, match=said):
            hanging_zero([stop(value) for value in values], cone)


def test_a_leg_held_straight_three_times_shows_how_well_it_is_held() -> None:
    one = straight_zero([stop(0.3)])
    assert (one.value, one.half) == (0.3, 1e-5) and "without the error of the straight pose" in one.how
    held = 0
    for seed in range(400):
        values = 0.3 + 0.002 * np.random.default_rng(seed).standard_normal(4)
        found = straight_zero([stop(v) for v in values])
        held += abs(found.value - 0.3) < found.half
    assert held / 400 == pytest.approx(0.95, abs=0.03)


# -- the command -------------------------------------------------------------------------------------------------

def simulated_stops(count: int) -> list[tuple[float, float]]:
    """(q1, q2) at which a leg with dry friction comes to rest, let go from either side."""
    body = LegBody(viscous=(0.05, 0.08))
    rng = np.random.default_rng(3)
    stops = []
    for k in range(count):
        plant = LegPlant(body, (0.0, (1, -1)[k % 2] * rng.uniform(0.3, 0.9)))
        state = plant.step(0.25, 0.0)
        while state.q1d or state.q2d:
            state = plant.step(0.25, 0.0)
        stops.append((state.q1, state.q2))
    return stops


def test_stops_of_a_simulated_leg_give_the_knee_zero(rig: Path, here: Path, shell: Shell) -> None:
    zero, step = 0.215, 2 * np.pi / 8192
    stops = simulated_stops(6)
    paths = [write_off(here / f"{k}.mcap", knee_rad=float(np.rint((zero + q2) / step) * step),
                       readings=hanging(q1, seed=k)) for k, (q1, q2) in enumerate(stops)]
    shell("calibrate encoder", *paths, "--rig", rig)
    out, err = shell.read()
    assert "6 stops spread over" in out and err == ""
    found = load_rig(rig).calibration.knee_zero_rad
    assert found == pytest.approx(zero, abs=0.01)
    half = float(out.split("knee zero: ")[1].split("+- ")[1].split(" ")[0])
    assert abs(found - zero) < half < 0.02
    # the IMU's zero of q1 adds to the interval: a bias within 0.1 m/s2
    left = load_rig(rig).tolerances["encoder_offset@2"][0]
    assert left == pytest.approx(np.hypot(half / 1.96, 0.1 / G), rel=0.05)
    text = rig.read_text()
    assert "# nothing measured yet" in text and "ASSUMED" not in text and "# the gearbox" in text
    assert "4 stops reached from either side" in shell.fails("calibrate encoder", *paths[:2], "--rig", rig, status=1)

    body = LegBody()
    write_model(here / "model.json", list(body.beta()), LEG)
    shell("calibrate encoder", *paths[:2], "--rig", rig, "--model model.json")
    cone = np.arcsin(body.coulomb[1] / (body.m2 * body.c2 * G))
    assert f"the model's friction of +- {cone:.3f} rad" in shell.out
    assert load_rig(rig).calibration.knee_zero_rad == pytest.approx(zero, abs=cone)


def test_encoder_records_that_say_nothing_are_refused(rig: Path, here: Path, shell: Shell) -> None:
    n = int(6 * TELEMETRY_HZ)
    write_off(here / "moved.mcap", knee_rad=np.where(np.arange(n) < n // 2, 0.1, 0.2))
    assert "the knee moved about 3.0 s" in shell.fails("calibrate encoder --straight moved.mcap --rig", rig, status=1)
    write_off(here / "armed.mcap", state=1)
    assert "never off" in shell.fails("calibrate encoder --straight armed.mcap --rig", rig, status=1)
    write_off(here / "short.mcap", seconds=0.5)
    assert "off for 0.5" in shell.fails("calibrate encoder --straight short.mcap --rig", rig, status=1)
    write_off(here / "blind.mcap")
    assert "--straight" in shell.fails("calibrate encoder blind.mcap --rig", rig)
    write_off(here / "aslant.mcap", readings=hanging(1.4))
    assert "calibrate mount" in shell.fails("calibrate encoder aslant.mcap --rig", rig, status=1)
    (here / "r.csv").write_text("time_s\n")
    assert "not a native run file" in shell.fails("calibrate encoder r.csv --rig", rig)
    assert rig.read_text() == RIG


def test_shunt_offset_with_its_interval_and_its_drift(rig: Path, tmp_path: Path, shell: Shell) -> None:
    inside = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        path = write_off(tmp_path / f"{seed}.mcap", 2.0, current_a=0.031 + 0.02 * rng.standard_normal(400))
        shell("calibrate shunt", path, "--rig", rig)
        out, err = shell.read()
        assert err == ""
        half = float(out.split("shunt offset: ")[1].split("+- ")[1].split(" ")[0])
        assert half == pytest.approx(2.09 * 0.02 / 20, rel=0.5)  # t of 19 degrees over the root of 400 samples
        inside += abs(load_rig(rig).calibration.shunt_offset_a - 0.031) < half
        per_a = load_rig(rig).calibration.torque_constant_nm_per_a
        assert load_rig(rig).tolerances["torque_offset@2"][0] == pytest.approx(per_a * half / 1.96, rel=0.05)
    assert inside >= 17
    shell("calibrate shunt", write_off(tmp_path / "dead.mcap"), "--rig", rig, "--dry-run")
    assert "is the sensor connected" in shell.err
    warm = 0.02 * rng.standard_normal(4000) + np.linspace(0.0, 0.03, 4000)
    shell("calibrate shunt", write_off(tmp_path / "w.mcap", 20.0, current_a=warm), "--rig", rig, "--dry-run")
    out, err = shell.read()
    assert "warning: w.mcap: the offset drifted by +0.03" in err and "would say" in out
    assert BLOCKS == 20


# -- from the devices --------------------------------------------------------------------------------------------

def test_zero_and_offset_from_the_devices_motor_off(here: Path, shell: Shell,
                                                    answers: Answers) -> None:
    mock = MockRig(StillPlant(StillState(q2=0.0)), firmware=FirmwareSettings(
        telemetry_hz=200, shunt_offset_a=0.031, knee_zero_rad=0.215, current_noise_a=0.01))
    path = here / "rig.toml"
    with PtyServer(mock.firmware, mock.clock) as port:
        path.write_text(RIG + f'\n[devices.controller]\nport = "{port.path}"\nrate_hz = 200\n')
        shell("calibrate shunt --rig rig.toml --seconds 1.5")
        shell("calibrate encoder --straight --rig rig.toml --seconds 1.2")
        assert "motor off" in shell.out
        answers()
        assert "nobody answers" in shell.fails("calibrate encoder --rig rig.toml")
    found = load_rig(path).calibration
    assert found.shunt_offset_a == pytest.approx(0.031, abs=0.004)
    assert found.knee_zero_rad == pytest.approx(0.215, abs=1e-3)
    path.write_text(RIG)
    assert "[devices.controller]" in shell.fails("calibrate shunt --rig rig.toml")
