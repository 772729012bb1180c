"""`legid record` with the controller on CAN: the same command, another table in rig.toml."""

import os
from pathlib import Path

import can
import numpy as np
import pytest

from daq.recording import Plan, write_plan
from daq.runs import read_run
from drivers import State
from drivers.can_codec import CanCodec
from drivers.mock import CanServer, MockRig
from legid.cli import main
from tests.support.processes import REAL_CLOCK
from tests.support.shell import Shell
from tests.support.still_plant import StillPlant

pytestmark = REAL_CLOCK

RIG = """[mechanism]
model = "leg2"
actuated = [2]
[devices.imu]
[devices.controller]
node = 3
watchdog_ms = 1000
can = {{interface = "{interface}", channel = "{channel}"}}
[limits]
staleness_s = 5.0
clock_bound_s = 5.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    t = np.arange(0.0, 0.6, 0.01)
    write_plan(Plan(t, 0.3 * np.sin(10 * t)), tmp_path / "plan.csv")
    return tmp_path


def record(folder: Path) -> int:
    return main(f"record --rig {folder}/rig.toml --plan {folder}/plan.csv --out {folder}/run.mcap".split())


def test_record_over_can(folder: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    channel = f"legid-record-{os.getpid()}"
    (folder / "rig.toml").write_text(RIG.format(interface="virtual", channel=channel))
    mock = MockRig(StillPlant(), codec=lambda: CanCodec(3))
    monkeypatch.setattr("experiments.rig.devices.open_bus", lambda path: mock.imu)
    with CanServer(mock.firmware, can.Bus(interface="virtual", channel=channel), mock.clock):
        assert record(folder) == 0, shell.err
    raw = read_run(folder / "run.mcap")
    assert raw.complete and raw.streams["/leg/telemetry"]["torque_cmd_nm"].max() > 0.25
    for topic, least in (("/leg/telemetry", 500), ("/leg/clock", 10), ("/imu", 200)):
        assert raw.streams[topic].size > least
    assert '"can"' in next(note.text for note in raw.config if note.kind == "link")
    assert mock.firmware.drive.state == State.DISARMED


def test_a_bus_that_is_not_there_is_one_line(folder: Path, shell: Shell) -> None:
    (folder / "rig.toml").write_text(RIG.format(interface="socketcan", channel="nocan7"))
    assert record(folder) == 1
    words = shell.err
    assert words.count("\n") == 1 and "leg controller on CAN nocan7" in words
    assert not (folder / "run.mcap").exists()


def test_a_node_that_does_not_exist_is_bad_input(folder: Path, shell: Shell) -> None:
    (folder / "rig.toml").write_text(RIG.format(interface="virtual", channel="x").replace("node = 3", "node = 64"))
    assert record(folder) == 2
    assert "node" in shell.err
