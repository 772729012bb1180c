"""Exported models in MJX, where it is installed: the same motion as in MuJoCo.

MJX 3.17 refuses `dcmotor` (ripple, presliding friction) and leaves polynomial damping (drag) out.
"""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from experiments.simulators import simulator_files
from tests.support.exported_models import model_of

STEPS, LEGS = 400, 8


@pytest.mark.parametrize("effects", [(), ("joint_stiffness",), ("rotor_inertia", "torque_offset"),
                                     ("end_stop_contact",), ("base_compliance",)], ids="-".join)
def test_a_batch_in_mjx_moves_as_mujoco_does(effects: tuple[str, ...], tmp_path: Path) -> None:
    """8 legs from different angles under a sine of torque, 400 steps, in double precision: below 1e-5 rad."""
    jax = pytest.importorskip("jax", reason="MJX is not installed: pip install mujoco-mjx")
    mjx = pytest.importorskip("mujoco.mjx", reason="MJX is not installed: pip install mujoco-mjx")
    jax.config.update("jax_enable_x64", True)
    text = simulator_files(model_of(tmp_path, 1, effects), "m.json", "legid export").texts["leg.xml"]
    model = mujoco.MjModel.from_xml_string(text)
    starts = np.random.default_rng(3).uniform(-0.4, 0.4, (LEGS, model.nq)) * (np.arange(model.nq) >= model.nq - 2)
    torque = 0.4 * np.sin(2 * np.pi * 2.0 * model.opt.timestep * np.arange(STEPS))
    expected = []
    for start in starts:
        data = mujoco.MjData(model)
        data.qpos[:] = start
        for value in torque:
            data.ctrl[0] = value
            mujoco.mj_step(model, data)
        expected.append(data.qpos.copy())
    there = mjx.put_model(model)
    blank = jax.jit(mjx.step)(there, mjx.put_data(model, mujoco.MjData(model)))  # with the types that a step returns
    blank = blank.replace(qpos=0.0 * blank.qpos, qvel=0.0 * blank.qvel, time=0.0 * blank.time, act=0.0 * blank.act)

    def run(start: object) -> object:
        def step(data: object, value: object) -> tuple[object, None]:
            return mjx.step(there, data.replace(ctrl=data.ctrl.at[0].set(value))), None  # type: ignore[attr-defined]

        return jax.lax.scan(step, blank.replace(qpos=start), torque)[0].qpos

    found = np.asarray(jax.jit(jax.vmap(run))(starts))
    assert np.abs(found - np.array(expected)).max() < 1e-5
