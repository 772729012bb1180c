"""Models as MJCF and URDF: MuJoCo reads both, and moves as `legid simulate` says."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec import structs
from numpy.testing import assert_allclose

import legid
from daq import load_rig
from daq.recording import Plan
from experiments.models import EffectValue, known_effects, load_model, save_model
from tests.support.exported_models import EFFECTS
from tests.support.models import LEG, LEG_RIG, write_model
from tests.support.mujoco_leg import Leg, random_leg
from tests.support.shell import Shell, read_json, typed

RATE_HZ = 500.0
SECONDS = 4.0


def leg_beta(leg: Leg, viscous: float = 1.0, coulomb: float = 0.0) -> list[float]:
    return list(leg.beta() * np.array([1, 1, 1, 1, 1, viscous, viscous, coulomb, coulomb]))


def leg_file(folder: Path, leg: Leg, *friction: float) -> Path:
    return write_model(folder / "m.json", leg_beta(leg, *friction), LEG)


def export(folder: Path, kind: str, model: Path) -> Path:
    out = folder / f"model.{kind}"
    typed("export", model, "--to", kind, "--out", out)
    return out


def load(folder: Path, kind: str, model: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(export(folder, kind, model)))


def drive(loaded: mujoco.MjModel, torque: np.ndarray, joint: int, q0: list[float], by_ctrl: bool
          ) -> tuple[np.ndarray, np.ndarray]:
    """(angles, readings of an IMU) at the samples of a torque that is held between them."""
    data = mujoco.MjData(loaded)
    data.qpos[:] = q0
    steps = round(1.0 / (RATE_HZ * loaded.opt.timestep))
    assert steps * loaded.opt.timestep * RATE_HZ == pytest.approx(1.0)
    angles, readings = [], []
    for tau in torque:
        if by_ctrl:
            data.ctrl[-1] = tau
        else:
            data.qfrc_applied[joint] = tau
        mujoco.mj_forward(loaded, data)
        angles.append(data.qpos.copy())
        if loaded.nsensor > loaded.nq:  # accelerometer x and y, gyro, as the run's columns
            readings.append([*data.sensor("accel").data[:2], -data.sensor("gyro").data[2]])
        for _ in range(steps):
            mujoco.mj_step(loaded, data)
    return np.array(angles), np.array(readings)


def simulate(model: Path, start: list[float], peak: float = 1.0, seconds: float = SECONDS
             ) -> Mapping[str, np.ndarray]:
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    plan = Plan(t, peak * (np.sin(5 * t) + 0.5 * np.sin(11 * t + 1)))
    return legid.simulate(model, plan, rate_hz=RATE_HZ, start=start).columns


def followed(folder: Path, model: Path, start: list[float], peak: float = 1.0, seconds: float = SECONDS,
             atol: float = 1e-6, torque: str = "tau2_cmd_nm", imu: bool = False) -> np.ndarray:
    """Angles of the exported model under the simulation's torque, which are the simulation's, as is what its IMU reads.

    IMU units are about a hundred times those of the angles in a motion this fast.
    """
    loaded = load(folder, "mjcf", model)
    own = simulate(model, start, peak, seconds)
    angles, readings = drive(loaded, own[torque], 0, start, by_ctrl=True)
    true = np.column_stack([own[name] for name in ("q1_rad", "q1_m", "q2_rad") if name in own])
    assert_allclose(angles, true, rtol=0, atol=atol)
    if imu:
        true = np.column_stack([own["accel_x_mps2"], own["accel_y_mps2"], own["gyro_radps"]])
        assert_allclose(readings, true, rtol=0, atol=1e-4)
    return angles


@pytest.mark.parametrize("viscous, peak", [(0.0, 0.4), (1.0, 0.4), (1.0, 1.0)])
@pytest.mark.parametrize("seed", [1, 2])
def test_mjcf_moves_as_the_simulation_does(seed: int, viscous: float, peak: float, tmp_path: Path) -> None:
    model = leg_file(tmp_path, random_leg(seed), viscous)
    assert np.ptp(followed(tmp_path, model, [0.4, -0.3], peak, imu=True), axis=0).min() > 0.5  # it does move


HELD = ("joint_stiffness", "quadratic_drag", "rotor_inertia", "torque_offset", "imu_lever_arm", "imu_misalignment")


def extend(path: Path, name: str, sizes: Mapping[str, float], joint: int | None) -> Path:
    """The model in the file with one effect more."""
    model = load_model(path)
    k = len(model.parameters) + len(sizes)
    joint = joint if known_effects()[name].per_joint else None
    save_model(structs.replace(model, effects=(EffectValue(name=name, joint=joint, sizes=dict(sizes)),),
                               reach=((-2.0, 2.0), (-2.0, 2.0)), covariance=((0.0,) * k,) * k), path)
    return path


@pytest.mark.parametrize("name", HELD)
def test_mjcf_holds_effects(name: str, tmp_path: Path, shell: Shell) -> None:
    """Five seconds under the torque as it was measured: angles, and the IMU's readings."""
    model = leg_file(tmp_path, random_leg(1))
    extend(model, name, EFFECTS[name].sizes, EFFECTS[name].joint)
    followed(tmp_path, model, [0.4, -0.3], 0.4, 5.0, 1e-7, "tau2_nm", imu=True)
    assert "left out" not in shell.err


@pytest.mark.parametrize("seed", [1, 2])
def test_mjcf_rubs_as_the_simulation_does(seed: int, tmp_path: Path) -> None:
    """Dry friction: within a milliradian over five seconds, of motion over more than half a radian."""
    model = leg_file(tmp_path, random_leg(seed), 1.0, 1.0)
    assert np.ptp(followed(tmp_path, model, [0.4, -0.3], 0.4, 5.0, 1e-3), axis=0).min() > 0.5


def test_effects_that_a_format_cannot_hold_are_named(tmp_path: Path, shell: Shell) -> None:
    for name, sizes, joint, kind in (("gyro_bias", {"bias": 0.01}, None, "mjcf"),
                                     ("joint_stiffness", {"stiffness": -0.1, "preload": 0.0}, 2, "urdf"),
                                     ("quadratic_drag", {"drag": 0.01}, 2, "urdf")):
        export(tmp_path, kind, extend(leg_file(tmp_path, Leg()), name, sizes, joint))
        assert f"{kind.upper()} cannot hold these effects of the model, they are left out: {name}" in \
            shell.err


@pytest.mark.parametrize("seed", [1, 2])
def test_other_bodies_move_alike(seed: int, tmp_path: Path) -> None:
    """The leg's own bodies against those of the export, knee spinning without friction: here every error grows."""
    leg = replace(random_leg(seed), viscous=(0.0, 0.0))
    exported, own = load(tmp_path, "mjcf", leg_file(tmp_path, leg)), leg.model(5e-4)
    assert abs(exported.body_mass[1] / own.body_mass[1] - 1) > 0.05  # they are not the same bodies
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    torque = np.sin(5 * t) + 0.5 * np.sin(11 * t + 1)
    (found, _), (true, _) = (drive(m, torque, 1, [0.4, -0.3], by_ctrl=False) for m in (exported, own))
    assert np.abs(true).max() > 2 * np.pi
    assert_allclose(found, true, rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", [3, 4])
def test_urdf_moves_alike(seed: int, tmp_path: Path) -> None:
    model = leg_file(tmp_path, random_leg(seed))
    loaded = load(tmp_path, "urdf", model)
    loaded.opt.integrator, loaded.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5e-4
    own = simulate(model, [0.4, -0.3])
    angles, _ = drive(loaded, own["tau2_cmd_nm"], 1, [0.4, -0.3], by_ctrl=False)
    assert_allclose(angles, np.column_stack([own["q1_rad"], own["q2_rad"]]), rtol=0, atol=1e-6)


def test_bodies_are_physical_and_keep_what_motion_shows(tmp_path: Path) -> None:
    leg = random_leg(5)
    beta = leg.beta()
    loaded = load(tmp_path, "mjcf", leg_file(tmp_path, leg, 1.0, 1.0))
    (m1, m2), (i1, i2) = loaded.body_mass[1:], loaded.body_inertia[1:, 1]
    (c1, c2), l1 = -loaded.body_ipos[1:, 2], -loaded.body_pos[2, 2]
    assert min(m1, m2, i1, i2) > 0
    assert l1 == pytest.approx(leg.l1)
    found = [i1 + m1 * c1**2 + m2 * l1**2, i2 + m2 * c2**2, m2 * l1 * c2, m1 * c1 + m2 * l1, m2 * c2]
    assert_allclose(found, beta[:5], rtol=1e-9)
    assert_allclose(loaded.dof_damping, beta[5:7])
    assert_allclose(loaded.dof_frictionloss, beta[7:9])


def test_rotor_and_offset(tmp_path: Path, shell: Shell) -> None:
    beta = [*leg_beta(Leg()), 0.01, 0.15]
    model = write_model(tmp_path / "m.json", beta, {**LEG, "rotor_inertia": (2,), "torque_offset": (2,)})
    followed(tmp_path, model, [0.0, 0.0])
    shell.read()
    export(tmp_path, "urdf", model)
    notes = shell.err
    assert "no rotor inertia: 0.01" in notes and "no torque offset: 0.15" in notes


def test_one_joint_and_a_chain(tmp_path: Path) -> None:
    one = write_model(tmp_path / "one.json", [0.02, 0.1, 0.03, 0.0], {"model": "joint1", "actuated": (1,)})
    followed(tmp_path, one, [0.5], 0.4)
    slide = write_model(tmp_path / "slide.json", [2.0, 0.5, 0.0],
                        {"model": "joint1", "actuated": (1,), "gravity_mps2": 0.0, "prismatic": True})
    followed(tmp_path, slide, [0.0])
    assert load(tmp_path, "urdf", slide).nq == 1
    chain = write_model(tmp_path / "chain.json", leg_beta(Leg()), {"model": "chain", "actuated": (2,), "links": 2})
    assert load(tmp_path, "mjcf", chain).nq == 2


def test_what_a_format_cannot_hold_is_said(tmp_path: Path, shell: Shell) -> None:
    beta = leg_beta(Leg(), coulomb=1.0)
    beta[5] = -0.003
    model = write_model(tmp_path / "m.json", beta, LEG)
    loaded = load(tmp_path, "mjcf", model)
    assert loaded.dof_damping[0] == 0.0
    notes = shell.err
    assert "viscous friction of pivot is -0.003" in notes and "frictionloss" in notes


@pytest.mark.parametrize("changes, words", [
    ({2: 1.0}, "not positive definite"), ({4: -0.1}, "no length"), ({4: 0.0}, "no length")])
def test_what_no_body_can_be(changes: dict[int, float], words: str, here: Path, shell: Shell) -> None:
    beta = leg_beta(Leg())
    for k, value in changes.items():
        beta[k] = value
    write_model(here / "m.json", beta, LEG)
    assert words in shell.fails("export m.json --to mjcf --out x.xml")
    assert not (here / "x.xml").exists()


def test_three_links_volts_and_run_options_are_refused(here: Path, shell: Shell) -> None:
    biped = write_model(here / "b.json", [1.0] * 8, {"model": "biped3", "actuated": (2, 3)})
    servo = write_model(here / "v.json", [1.0] * 4, {"model": "joint1", "actuated": (1,), "input": "voltage"})
    leg = leg_file(here, Leg())
    for model, more, said in ((biped, "", "one or two links"), (servo, "", "volt"), (leg, "--rate 100", "--rate")):
        assert said in shell.fails("export", model, "--to urdf --out x.urdf", more)
    assert read_json(biped)["schema"] == "legid.model/1"


def test_urdf_has_the_limits_of_a_rig_and_a_safety_controller(here: Path, shell: Shell) -> None:
    """The speed bound falls as the joint can decelerate; at rest all torque is there."""
    rig, out = here / "rig.toml", here / "leg.urdf"
    rig.write_text(LEG_RIG.format(q1=1.0))
    limits = load_rig(rig).limits
    command = "export", leg_file(here, Leg()), "--to urdf --out", out
    shell(*command)
    assert "no joint has a limit" in shell.err
    shell(*command, "--force --rig rig.toml")
    assert "no joint has a limit" not in shell.err
    passive, driven = ET.parse(out).getroot().findall("joint")
    assert passive.get("type") == driven.get("type") == "revolute" and passive.find("safety_controller") is None
    bound, keeper = driven.find("limit"), driven.find("safety_controller")
    assert (float(bound.get("effort", 0)), float(bound.get("upper", 0))) == (limits.torque_nm, limits.q2_rad)
    speed, k_position = float(bound.get("velocity", 0)), float(keeper.get("k_position", 0))
    assert speed == limits.speed_radps and k_position * speed == pytest.approx(limits.stop_radps2)
    assert float(keeper.get("k_velocity", 0)) * speed == pytest.approx(limits.torque_nm)
    assert mujoco.MjModel.from_xml_path(str(out)).jnt_range[1, 1] == pytest.approx(limits.q2_rad)
