"""What `legid doctor` says of a pivot sensor and of a second shunt: whole, and with one thing wrong at a time."""

from collections.abc import Callable
from pathlib import Path

import pytest

from daq import parse_rig
from drivers.as5600 import MD, MH, ML
from drivers.mock import I2cServer, MockRig, PivotSettings, ShuntSettings
from experiments.doctor import preflight
from experiments.doctor.check import Check
from tests.support.processes import REAL_CLOCK
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[devices.pivot]
bus = "{bus}"
rate_hz = 100.0
[devices.shunt]
bus = "{bus}"
shunt_ohm = {ohm}
rate_hz = 100.0
[calibration]
second_shunt_offset_a = 0.02
"""


def examine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ohm: float = 0.01, magnet: PivotSettings | None = None,
            spoil: Callable[[MockRig], object] = lambda rig: None) -> dict[str, Check]:
    monkeypatch.setattr(preflight, "LISTEN_S", 0.4)
    monkeypatch.setattr(preflight, "check_disk", lambda folder: [])
    rig = MockRig(StillPlant(), pivot=magnet or PivotSettings(), shunt=ShuntSettings(ohm, offset_v=0.02 * ohm))
    spoil(rig)
    with I2cServer(rig.bus, tmp_path / "i2c"):
        text = RIG.format(bus=tmp_path / "i2c", ohm=ohm)
        return {check.name: check for check in preflight.examine(parse_rig(text), text, "rig.toml", tmp_path)}


def test_a_rig_with_nothing_else_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = examine(tmp_path, monkeypatch)
    assert set(checks) == {"pivot sensor", "pivot magnet", "second shunt", "second shunt zero", "tolerances"}
    assert all(check.status in ("ok", "warn") for check in checks.values()), checks
    assert checks["pivot magnet"].status == checks["second shunt zero"].status == "ok"
    assert "gain 64, best is 128 at 5 V" in checks["pivot magnet"].words
    assert "range 8.19 A" in checks["second shunt zero"].words


@pytest.mark.parametrize("spoil, name, status, line", [
    (lambda rig: setattr(rig.pivot, "status", 0), "pivot sensor", "FAIL", "no magnet: the field is too weak"),
    (lambda rig: setattr(rig.pivot, "status", MD | ML), "pivot magnet", "warn", "too weak: the gain is at its most"),
    (lambda rig: setattr(rig.pivot, "status", MD | MH), "pivot magnet", "warn", "too strong: the gain is at its least"),
    (lambda rig: rig.pivot.fail(121, 9), "pivot sensor", "FAIL", "AS5600 at 0x36: no acknowledge; check wiring"),
    (lambda rig: rig.shunt.fail(121, 9), "second shunt", "FAIL", "INA226 at 0x40: no acknowledge; check wiring"),
    (lambda rig: setattr(rig.shunt, "held_at", 0), "second shunt", "FAIL", "correct [devices.shunt] kind or address"),
])
def test_what_is_wrong_is_one_line_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: Callable[[MockRig], object], name: str, status: str,
        line: str) -> None:
    check = examine(tmp_path, monkeypatch, spoil=spoil)[name]
    assert check.status == status and line in check.words and "\n" not in check.words


def test_a_shunt_whose_range_ends_before_the_torque_limit_is_refused(tmp_path: Path,
                                                                     monkeypatch: pytest.MonkeyPatch) -> None:
    check = examine(tmp_path, monkeypatch, ohm=0.1)["second shunt zero"]
    assert check.status == "FAIL" and "torque_nm is 2 A; use a shunt of less resistance" in check.words


def test_a_zero_that_is_off_and_an_angle_that_jumps_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(rig: MockRig) -> None:
        rig.shunt._settings = ShuntSettings(offset_v=1e-3)

    checks = examine(tmp_path, monkeypatch, magnet=PivotSettings(noise_rad=0.03), spoil=wrong)
    assert checks["pivot magnet"].status == "warn" and "counts at rest" in checks["pivot magnet"].words
    assert checks["second shunt zero"].status == "FAIL"
    told = float(checks["second shunt zero"].words.rpartition("set [calibration] second_shunt_offset_a = ")[2])
    assert told == pytest.approx(0.1, abs=1e-3)
