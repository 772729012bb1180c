"""Committed recordings with one fault each: played back they are the same run and give the same fit, to the bit."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from daq.runs import RawRun, read_run
from daq.timing import recorded_rig
from estimator import FitResult
from experiments.emulation import LegBody, replay_run
from experiments.workflows import fit_runs
from tests.support.paths import FIXTURES
from tests.support.sensor_bench import SensorBench
from tests.support.shell import Shell, typed

NAMES = ("healthy", "pulled-cable", "gap", "clock-reset", "saturated-gyro", "noisy")
SAID = {"pulled-cable": "the connection is gone", "gap": "bus errors [errno 121]",
        "clock-reset": "leg controller restarted", "saturated-gyro": "limit q1_speed_radps"}


def recorded(name: str) -> Path:
    return FIXTURES / f"{name}.mcap"


def replayed(name: str, folder: Path, *more: object) -> Path:
    out = folder / f"{name}-{len(list(folder.iterdir()))}.mcap"
    typed("record --replay", recorded(name), "--out", out, *map(str, more))
    return out


@cache
def fit_of(path: Path) -> FitResult:
    result = fit_runs([path], recorded_rig(read_run(path)), choose=False).result
    assert result.converged
    return result


def fitted(path: Path) -> bytes:
    """Every number of the fit, and which way it came there."""
    result = fit_of(path)
    return result.beta.tobytes() + result.covariance.tobytes() + repr((result.iterations, result.noise)).encode()


def same_streams(a: RawRun, b: RawRun) -> bool:
    return all(a.streams[topic].tobytes() == b.streams[topic].tobytes() for topic in a.streams)


@pytest.mark.parametrize("name", NAMES)
def test_a_fixture_comes_back_and_refits_to_the_bit_twice(name: str, tmp_path: Path) -> None:
    first, second = (replayed(name, tmp_path) for _ in range(2))
    original, once, twice = map(read_run, (recorded(name), first, second))
    assert original.streams["/imu"].size > 300
    assert same_streams(original, once)
    assert once.events[1:] == original.events  # before them it is said that this is a replay
    assert once.config == original.config
    assert same_streams(once, twice) and once.events == twice.events and once.facts == twice.facts
    assert fitted(recorded(name)) == fitted(first) == fitted(second)


def test_a_pivot_sensor_and_a_second_shunt_come_back(tmp_path: Path) -> None:
    """And are supervised again: the magnet that was lost ends the replay's own run, too."""
    bench = SensorBench(tmp_path / "r.mcap")
    bench.fails(on_progress=lambda now_s, total_s: now_s > 0.3 and setattr(bench.mock.pivot, "status", 0))
    done = replay_run(tmp_path / "again.mcap", bench.path)
    original, again = read_run(bench.path), read_run(tmp_path / "again.mcap")
    assert same_streams(original, again) and original.streams["/pivot"].size == original.streams["/shunt"].size > 200
    assert done.trip.startswith("limit q1_rad tripped: pivot angle in rad cannot be checked")


@pytest.mark.parametrize("name", NAMES)
def test_fixtures_hold_what_they_are_named_after_and_fit_the_leg(name: str) -> None:
    run = read_run(recorded(name))
    said = " ".join(f"{note.kind} {note.text}" for note in run.events)
    assert all((text in said) == (name == other) for other, text in SAID.items())
    clipped = np.abs(run.streams["/imu"]["gyro_z"].astype(int)) >= 32_767
    assert clipped.any() == (name == "saturated-gyro")
    found, truth = fit_of(recorded(name)).beta, np.array(LegBody().beta())
    assert found[:5] == pytest.approx(truth[:5], rel=0.06 if name == "noisy" else 0.015)


def test_a_replay_says_that_it_is_one(tmp_path: Path, shell: Shell) -> None:
    out = replayed("pulled-cable", tmp_path)
    assert "REPLAY" in shell.out
    assert read_run(out).facts["replay_of"] == "pulled-cable.mcap"
    assert "REPLAY" in read_run(out).events[0].text
    shell("info", out)
    assert "REPLAY of pulled-cable.mcap" in shell.out


def test_a_replay_under_other_limits_names_the_one_that_it_would_pass(
        tmp_path: Path, shell: Shell) -> None:
    replayed("healthy", tmp_path)
    assert "limit" not in shell.out
    tight = tmp_path / "tight.toml"
    tight.write_text((FIXTURES / "rig.toml").read_text().replace("q2_rad = 3.0", "q2_rad = 0.3"))
    replayed("healthy", tmp_path, "--rig", tight)
    assert "limit q2_rad tripped" in shell.out


def test_a_damaged_run_is_not_played_into_a_whole_one(here: Path, shell: Shell) -> None:
    cut = here / "cut.mcap"
    cut.write_bytes(recorded("healthy").read_bytes()[:200_000])
    assert "is damaged: its end is missing" in shell.fails("record --replay cut.mcap --out out.mcap")


def test_a_run_of_another_kind_of_recorder_is_refused_by_name(here: Path, shell: Shell) -> None:
    from tests.support.motor_off_runs import write_off

    write_off(here / "still.mcap")  # no device said in it what it is
    said = shell.fails("record --replay still.mcap --out n.mcap")
    assert "does not say which firmware it is of" in said
    assert not (here / "n.mcap").exists()
