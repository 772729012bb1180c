"""`legid export --samples N`: models by the joint covariance, as folders and as a batch of mujoco.rollout."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec import structs

from experiments.models import save_model
from experiments.simulators import draw_models
from tests.support.exported_models import model_of
from tests.support.shell import Shell


def uncertain(folder: Path, share: float = 0.02) -> tuple[object, np.ndarray]:
    """A leg with a spring and bristles, and its covariance: correlated, one size not determined."""
    model = model_of(folder, 1, ("joint_stiffness", "stribeck_friction"))
    values = np.array([*model.beta, *(v for e in model.effects for v in (*e.sizes.values(), *e.shapes.values()))])
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((values.size, values.size)) / np.sqrt(values.size)
    root = share * np.abs(values)[:, None] * (np.eye(values.size) + 0.5 * mixed)
    root[-1] = 0.0  # the exponent is held
    covariance = root @ root.T
    rows = [[float(c) for c in row] for row in covariance]
    open_rows = [[None if 5 in (i, j) else c for j, c in enumerate(row)]
                 for i, row in enumerate(rows)]
    return structs.replace(model, covariance=tuple(map(tuple, open_rows))), covariance


def test_draws_have_the_model_s_mean_and_covariance(tmp_path: Path) -> None:
    model, covariance = uncertain(tmp_path, 0.005)
    samples = draw_models(model, "m.json", 2000, 1)  # type: ignore[arg-type]
    assert samples.held == ("beta6",) and np.ptp(samples.values[:, 5]) == 0.0
    free = [k for k in range(len(covariance)) if k not in (5, len(covariance) - 1)]
    scale = np.sqrt(np.diag(covariance))[free]
    found = np.cov(samples.values[:, free].T) / np.outer(scale, scale)
    np.testing.assert_allclose(found, covariance[np.ix_(free, free)] / np.outer(scale, scale), atol=0.1)
    assert samples.names[9:] == ("joint_stiffness@1.stiffness", "joint_stiffness@1.preload",
                                 "stribeck_friction@2.excess_torque", "stribeck_friction@2.stribeck_velocity",
                                 "stribeck_friction@2.exponent")


def test_no_draw_is_a_leg_that_cannot_be(tmp_path: Path) -> None:
    model, _ = uncertain(tmp_path, 0.4)
    samples = draw_models(model, "m.json", 50, 1)  # type: ignore[arg-type]
    assert samples.redrawn > 0
    assert samples.values[:, 5:9].min() >= 0.0 and samples.values[:, 11].min() >= 0.0


def test_samples_are_written_and_run_as_a_batch(tmp_path: Path, shell: Shell) -> None:
    model, _ = uncertain(tmp_path)
    save_model(model, tmp_path / "m.json")  # type: ignore[arg-type]
    words = "export", tmp_path / "m.json", "--to mujoco --out", tmp_path / "sim", "--samples 8 --seed 4"
    shell(*words)
    assert "kept at the model's value: beta6" in shell.err
    first = (tmp_path / "sim" / "samples.csv").read_text()
    shell(*words)
    assert (tmp_path / "sim" / "samples.csv").read_text() == first
    rows = list(csv.DictReader(first.splitlines()))
    for row in rows:
        loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "sim" / "samples" / row["model"] / "leg.xml"))
        assert loaded.dof_damping[1] == pytest.approx(float(row["beta7"]))
        assert loaded.jnt_stiffness[0] == pytest.approx(float(row["joint_stiffness@1.stiffness"]))
    done = subprocess.run([sys.executable, "-I", str(tmp_path / "sim" / "batch.py")], capture_output=True, text=True,
                          check=False, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("8 models") and "standard deviation 0 rad" not in done.stdout


def test_a_model_without_a_covariance_is_refused(tmp_path: Path, shell: Shell) -> None:
    save_model(model_of(tmp_path, 1, ()), tmp_path / "m.json")
    words = "export", tmp_path / "m.json", "--to mujoco --out", tmp_path / "s", "--samples 2"
    assert "states no covariance" in shell.fails(*words)
