"""The distance meter's ways in: a column of a CSV with a table in the rig file, a stream of a run file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq import InputError, parse_rig
from daq.runs import RunWriter, read_run, write_csv
from daq.timing import align, recorded_rig
from estimator import fit
from estimator.calibration import DistanceMeter
from experiments.session import prepare
from studies.biped3.study import CASES, case_options, noisy_record
from studies.walker import one_step
from tests.support.paths import FIXTURES
from tests.support.runs import with_columns, without

RIG = """[mechanism]
model = "biped3"
actuated = [2, 3]
gravity_mps2 = 9.8
[sampling]
hold = "zero"
[distance_meter]
mount_m = 0.6
gamma_rad = 0.6
sigma_m = 5e-4
sigma_per_m = 2e-3
"""
METER = DistanceMeter(0.6, 0.6, 5e-4, 2e-3)


def test_a_csv_of_distances_is_fitted_with_the_noise_of_each(tmp_path: Path) -> None:
    step = one_step()
    data = noisy_record(step, CASES[0], 5, 0)
    distance = METER.read(step.q[:, 0], np.random.default_rng(4))
    write_csv(with_columns(without(data, "q1_rad"), distance_m=distance), tmp_path / "walk.csv")
    setup = prepare([tmp_path / "walk.csv"], parse_rig(RIG)).setup
    sigma = setup.datasets[0]["q1_sigma_rad"]
    assert np.ptp(sigma) > 0.1 * sigma.mean()
    off = (setup.datasets[0]["q1_rad"] - step.q[:, 0]) / sigma
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.2)
    assert setup.options.noise["encoder1_rad"] == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=1e-3)
    known = replace(setup.options, noise={**case_options(CASES[2]).noise, **setup.options.noise})
    result = fit(setup.datasets, setup.mechanism, known)
    assert result.converged


def test_a_meter_needs_a_mechanism_that_stands(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="stands on no ground"):
        parse_rig(RIG.replace("biped3", "leg2").replace("[2, 3]", "[2]"))
    with pytest.raises(InputError, match="q1_rad"):
        (tmp_path / "walk.csv").write_text("time_s,q2_rad,q3_rad,tau2_nm,tau3_nm,distance_m\n" + "".join(
            f"{0.01 * k},0,0,0,0,0.7\n" for k in range(60)))
        prepare([tmp_path / "walk.csv"], parse_rig(RIG.partition("[distance_meter]")[0]))


def test_a_run_file_holds_distances_as_a_stream(tmp_path: Path) -> None:
    raw = read_run(FIXTURES / "healthy.mcap")
    telemetry = raw.streams["/leg/telemetry"]
    first, last = int(telemetry["host_ns"][0]), int(telemetry["host_ns"][-1])
    writer = RunWriter(tmp_path / "run.mcap", raw.files)
    times = np.arange(first, last, 10_000_000)
    for k, t_ns in enumerate(times.tolist()):
        writer.add("/distance", t_ns, t_ns, 0.7 + 0.1 * np.sin(1e-9 * (t_ns - first)), int(not 200 <= k < 220))
    writer.close()
    found = read_run(tmp_path / "run.mcap").streams["/distance"]
    assert found.size == times.size
    data = align(replace(raw, streams={**raw.streams, "/distance": found}), recorded_rig(raw), 100.0)
    column, late = data["distance_m"], data.time_s
    hole = ~np.isfinite(column)
    assert 0.15 < hole.sum() / 100.0 < 0.25
    np.testing.assert_allclose(column[~hole], 0.7 + 0.1 * np.sin(late[~hole]), atol=1e-4)
