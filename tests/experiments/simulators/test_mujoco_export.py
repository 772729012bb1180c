"""Folders that `legid export --to mujoco` writes: they move as `legid simulate` does, and need no legid."""

import csv
from collections.abc import Sequence
from pathlib import Path
from runpy import run_path

import mujoco
import numpy as np
import pytest
from msgspec import structs

from daq import InputError
from experiments.models import Model, TorqueTable, load_model, save_model
from experiments.models.schema import JointTorque, StructureValues, TableInput
from experiments.simulators import ExportedLeg, draw_models, require_mujoco, simulator_files
from experiments.simulators.parts import OF_LOOP, parts_of
from tests.support.exported_models import (
    EFFECTS,
    OPPOSITE,
    PAIRS,
    START,
    angle_error,
    in_mujoco,
    model_of,
    simulated,
)
from tests.support.imported_files import table_of
from tests.support.paths import REAL
from tests.support.processes import ran
from tests.support.shell import Shell, document

WITHIN_RAD = 1e-3
TWISTED = (("joint_elasticity", "torque_saturation"), ("backlash", "torque_offset"),
           ("joint_elasticity", "torque_delay"))
"""A gear twists under the torque that acts."""


def test_every_effect_of_the_library_is_held_or_left() -> None:
    from estimator.effects.registry import library_classes

    names = {kind.name for kind in library_classes()}
    assert names - set(OF_LOOP) == set(EFFECTS)  # all of which are exported below
    assert set(OF_LOOP) == {kind.name for kind in library_classes() if kind.per_loop}


def test_an_export_says_where_the_log_alone_is_wrong(tmp_path: Path) -> None:
    model = model_of(tmp_path, 2, ("encoder_scale",))
    (effect,) = model.effects
    for heard, said in ((1.0, False), (0.0, True)):
        own = structs.replace(model, effects=(structs.replace(effect, shapes={"heard_by_loop": heard}),))
        assert any("is of the log alone" in note for note in parts_of(own, "m.json").notes) == said


@pytest.mark.parametrize("names", [(), *((name,) for name in EFFECTS), *PAIRS, *TWISTED], ids="+".join)
def test_an_export_moves_as_the_simulation_does(names: Sequence[str], tmp_path: Path) -> None:
    """Five seconds in steps of a millisecond, from the same state, under the torque as it was measured."""
    assert angle_error(model_of(tmp_path, 2, names), 1e-3) < WITHIN_RAD


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("names", [(), *((name,) for name in EFFECTS), *PAIRS], ids="+".join)
def test_an_export_moves_alike_in_short_steps(names: Sequence[str], seed: int, tmp_path: Path) -> None:
    model = model_of(tmp_path, seed, names)
    assert max(angle_error(model, step) for step in (1e-3, 2.5e-4)) < WITHIN_RAD


@pytest.mark.parametrize("names", [("torque_delay",), ("sensor_time_skew",), ("torque_delay", "sensor_time_skew")],
                         ids="+".join)
def test_delays_of_the_other_sign(names: Sequence[str], tmp_path: Path) -> None:
    assert angle_error(model_of(tmp_path, 2, names, OPPOSITE), 1e-3) < WITHIN_RAD


@pytest.mark.parametrize("name", ["stribeck_friction", "load_dependent_friction", "presliding_friction"])
def test_friction_with_a_broad_smoothing_velocity(name: str, tmp_path: Path) -> None:
    assert angle_error(model_of(tmp_path, 2, (name,), smoothing=0.1), 1e-3) < WITHIN_RAD


@pytest.mark.parametrize("names", [(), ("imu_misalignment",), ("sensor_time_skew",), ("gyro_bias", "gyro_scale"),
                                   ("accelerometer_bias",), ("base_compliance",)], ids="+".join)
def test_an_imu_reads_as_the_simulation_says(names: Sequence[str], tmp_path: Path) -> None:
    model = model_of(tmp_path, 2, names)
    run = simulated(model)
    found = in_mujoco(model, run, 1e-3)
    assert np.abs(found["gyro_radps"] - run["gyro_radps"]).max() < 3e-3
    for column in ("accel_x_mps2", "accel_y_mps2"):  # where dry friction turns over it differs for one sample
        assert np.quantile(np.abs(found[column] - run[column]), 0.99) < 0.02


def test_a_structure_is_held(tmp_path: Path) -> None:
    tables = (TorqueTable(inputs=(TableInput(variable="angle", joint=2),), knots=((-1.0, 0.0, 1.0),),
                          values=(0.1, -0.05, 0.08), std=(0.0,) * 3),
              TorqueTable(inputs=(TableInput(variable="angle", joint=1), TableInput(variable="rate", joint=2)),
                          knots=((-0.5, 0.5), (-3.0, 0.0, 3.0)), values=(0.0, 0.05, 0.02, -0.03, 0.0, 0.04),
                          std=(0.0,) * 6),
              TorqueTable(inputs=(TableInput(variable="motor torque", joint=2),), directed=True, knots=((-0.5, 0.5),),
                          values=(0.01, 0.03), std=(0.0,) * 2))
    structure = StructureValues(torques=(JointTorque(joint=2, constant=0.01, tables=tables, noise_nm=0.01),),
                                removed=0.5, removed_ci95=(0.4, 0.6))
    model = model_of(tmp_path, 2, (), structure=structure)
    plain = model_of(tmp_path, 2, ())
    assert np.abs(simulated(model)["q2_rad"] - simulated(plain)["q2_rad"]).max() > 0.05  # it does something
    assert angle_error(model, 1e-3) < WITHIN_RAD


def test_the_file_alone_says_what_it_needs_and_leaves(tmp_path: Path) -> None:
    files = simulator_files(model_of(tmp_path, 1, ("torque_ripple", "torque_saturation")), "m.json", "legid export")
    assert files.needs == (3, 7) and any("leg.py applies torque_saturation" in note for note in files.notes)
    assert "torque_saturation" in files.texts["leg.py"] and "cogging" in files.texts["leg.xml"]
    with pytest.raises(InputError, match=r"MuJoCo .* is older than 99\.0"):
        require_mujoco((99, 0))


def test_noise_is_seeded_and_has_the_model_s_levels(tmp_path: Path) -> None:
    noise = {"gyro_radps": 0.01, "accel_x_mps2": 0.05, "accel_y_mps2": 0.4, "accel_correlation": 0.8}
    files = simulator_files(model_of(tmp_path, 1, (), noise=noise), "m.json", "legid export")
    for name, text in files.texts.items():
        (tmp_path / name).write_text(text)
    leg_class = run_path(str(tmp_path / "leg.py"))["Leg"]
    legs = [leg_class(seed=seed) for seed in (1, 1, 2)]
    rows = [[leg.observe() for _ in range(4000)] for leg in legs]
    assert rows[0] == rows[1] and rows[0] != rows[2]
    read = np.array([[row[c] for c in ("gyro_radps", "accel_x_mps2", "accel_y_mps2")] for row in rows[0]])
    assert read.std(axis=0) == pytest.approx([0.01, 0.05, 0.4], rel=0.05)
    assert np.corrcoef(read.T)[1, 2] == pytest.approx(0.8, abs=0.03)


def test_the_folder_runs_without_legid(here: Path, shell: Shell) -> None:
    """`python -I` in another folder, where legid's packages cannot be imported."""
    model = model_of(here, 1, ("stribeck_friction", "torque_saturation", "gyro_bias"))
    save_model(model, here / "m.json")
    run = simulated(model)
    table_of(run, here / "run.csv")
    shell("export m.json --to mujoco --out sim")
    assert "leg.py applies gyro_bias, stribeck_friction, torque_saturation" in shell.err
    hide = ("import sys, runpy; sys.modules.update(dict.fromkeys(('legid', 'estimator', 'experiments', 'daq', "
            "'drivers'))); sys.argv = ['leg.py', sys.argv[1]]; runpy.run_path({!r}, run_name='__main__')")
    done = ran("-I", "-c", hide.format(str(here / "sim/leg.py")), here / "run.csv", cwd=Path("/"))
    errors = {line.split()[0]: float(line.split()[1]) for line in done.stdout.splitlines()[1:]}
    assert set(errors) == {"q1_rad", "q2_rad", "gyro_radps", "accel_x_mps2", "accel_y_mps2"}
    assert max(errors["q1_rad"], errors["q2_rad"]) < 5e-3  # its start is by the first tenth of a second
    lost = ran("-I", here / "sim/leg.py", here / "m.json", status=1)
    assert lost.stderr.count("\n") == 1 and "is no table" in lost.stderr


def test_what_no_export_can_hold_is_refused_by_name(here: Path, shell: Shell) -> None:
    for name, sizes, words in (
            ("presliding_friction", {"level": 0.3, "bristle_damping": 0.0}, "more than the Coulomb friction"),
            ("base_compliance", {"mobility": 2.0}, "the leg alone has")):
        changed = {name: EFFECTS[name]._replace(sizes=sizes)}
        save_model(model_of(here, 1, (name,), changed), here / "m.json")
        error = shell.fails("export m.json --to mujoco --out x")
        assert name in error and words in error and "take it out of `effects`" in error
    assert not (here / "x").exists()


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "dfki_c0").is_dir(), reason="no real records next to the checkout")
def test_a_real_arm_errs_alike_in_mujoco(here: Path, shell: Shell) -> None:
    """Free runs of the exported model err as legid's own do, within 2 %; leg.xml keeps the first states by run."""
    folder, model = REAL / "dfki_c0", here / "m.json"
    rig, held = ("--rig", folder / "rig.toml"), folder / "02.csv.gz"
    shell("fit", *(folder / f"{k}.csv.gz" for k in ("00", "01", "04")), *rig, "--model-out m.json")
    shell.read()
    errors = {}
    for simulator in ("legid", "mujoco"):
        found = document("validate m.json", held, *rig, "--simulator", simulator)
        segments = [one["summed_squared_error"] for one in found["runs"]]
        errors[simulator] = {name: np.sqrt(sum(one[name] for one in segments)) for name in segments[0]}
    assert errors["mujoco"] == pytest.approx(errors["legid"], rel=0.02)
    assert "MuJoCo's free runs against legid's own" in shell.out
    shell("export m.json --to mujoco --out sim --starts", held, *rig)
    loaded = mujoco.MjModel.from_xml_path(str(here / "sim/leg.xml"))
    assert loaded.key("02").qpos.shape == (2,) and np.abs(loaded.key("02").qvel).max() > 0.0
    assert len(START) == ExportedLeg(load_model(model), "m").leg.model.nq


def test_options_that_belong_elsewhere_are_refused(here: Path, shell: Shell) -> None:
    save_model(model_of(here, 1, ()), here / "m.json")
    for words in ("mjcf --starts run.csv", "mujoco --rate 100", "mujoco --rig rig.toml"):
        shell.fails("export m.json --out x --to", words)


def uncertain(folder: Path, share: float = 0.02) -> tuple[Model, np.ndarray]:
    """A leg with a spring and bristles, and its covariance: correlated, one size not determined."""
    model = model_of(folder, 1, ("joint_stiffness", "stribeck_friction"))
    values = np.array([*model.beta, *(v for e in model.effects for v in (*e.sizes.values(), *e.shapes.values()))])
    rng = np.random.default_rng(3)
    mixed = rng.standard_normal((values.size, values.size)) / np.sqrt(values.size)
    root = share * np.abs(values)[:, None] * (np.eye(values.size) + 0.5 * mixed)
    root[-1] = 0.0  # the exponent is held
    covariance = root @ root.T
    rows = tuple(tuple(None if 5 in (i, j) else float(c) for j, c in enumerate(row))
                 for i, row in enumerate(covariance))
    return structs.replace(model, covariance=rows), covariance


def test_draws_have_the_model_s_mean_and_covariance(tmp_path: Path) -> None:
    model, covariance = uncertain(tmp_path, 0.005)
    samples = draw_models(model, "m.json", 2000, 1)
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
    samples = draw_models(model, "m.json", 50, 1)
    assert samples.redrawn > 0
    assert samples.values[:, 5:9].min() >= 0.0 and samples.values[:, 11].min() >= 0.0


def test_samples_are_written_and_run_as_a_batch(here: Path, shell: Shell) -> None:
    model, _ = uncertain(here)
    save_model(model, here / "m.json")
    words = "export m.json --to mujoco --out sim --samples 8 --seed 4"
    shell(words)
    assert "kept at the model's value: beta6" in shell.err
    first = (here / "sim/samples.csv").read_text()
    shell(words)
    assert (here / "sim/samples.csv").read_text() == first
    rows = list(csv.DictReader(first.splitlines()))
    for row in rows:
        loaded = mujoco.MjModel.from_xml_path(str(here / "sim/samples" / row["model"] / "leg.xml"))
        assert loaded.dof_damping[1] == pytest.approx(float(row["beta7"]))
        assert loaded.jnt_stiffness[0] == pytest.approx(float(row["joint_stiffness@1.stiffness"]))
    done = ran("-I", here / "sim/batch.py")
    assert done.stdout.startswith("8 models") and "standard deviation 0 rad" not in done.stdout


def test_a_model_without_a_covariance_is_refused(here: Path, shell: Shell) -> None:
    save_model(model_of(here, 1, ()), here / "m.json")
    words = "export m.json --to mujoco --out s --samples 2"
    assert "states no covariance" in shell.fails(words)
