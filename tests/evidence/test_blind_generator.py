"""The blind bench's generator: its physics against MuJoCo and closed forms, its faults, its files, its score."""

import ast
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark
from scipy.integrate import cumulative_simpson

from daq import load_rig
from evidence.blind import bench
from evidence.blind.cases import Case, draw_case, strengths
from evidence.blind.effects import INSIDE, LARGEST, MAKERS, OUTSIDE
from evidence.blind.excite import PATTERN, draw
from evidence.blind.leg import COEFFICIENTS, Leg
from evidence.blind.measure import COLUMNS, Sensors, coloured, imu, read
from evidence.blind.physics import integrate
from evidence.blind.score import Outcome, Rate, sizes_inside
from tests.support.paths import ROOT

pytestmark = mark.slow

BLIND = ROOT / "evidence/blind"
GENERATORS = ("bench", "cases", "effects", "excite", "friction", "geared", "leg", "measure", "outside", "physics",
              "ratio", "servo", "several_faults", "stickslip")
XML = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81" integrator="RK4"/>
  <worldbody>
    <body name="upper">
      <joint type="hinge" axis="0 -1 0" damping="{leg.viscous1}"/>
      <inertial pos="0 0 -{leg.c1}" mass="{leg.m1}" diaginertia="{leg.i1} {leg.i1} {leg.i1}"/>
      <site name="imu" pos="0 0 -0.2"/>
      <body name="lower" pos="0 0 -{leg.l1}">
        <joint type="hinge" axis="0 -1 0" damping="{leg.viscous2}" armature="{armature}"/>
        <inertial pos="0 0 -{leg.c2}" mass="{leg.m2}" diaginertia="{leg.i2} {leg.i2} {leg.i2}"/>
      </body>
    </body>
  </worldbody>
  <sensor><accelerometer site="imu"/><gyro site="imu"/></sensor>
</mujoco>"""


def smooth(leg: Leg) -> Leg:
    return Leg(**{**leg.__dict__, "coulomb1": 0.0, "coulomb2": 0.0})


def mujoco_rows(leg: Leg, tau: np.ndarray, substeps: int, armature: float = 0.0) -> np.ndarray:
    """q1, q2, gyro, a_x, a_y at the samples of a torque that is linear in between."""
    model = mujoco.MjModel.from_xml_string(XML.format(step=0.01 / substeps, leg=leg, armature=armature))
    data = mujoco.MjData(model)
    rows = []
    for now, following in zip(tau, np.append(tau[1:], tau[-1])):
        data.qfrc_applied[1] = now
        mujoco.mj_forward(model, data)
        s = data.sensordata
        rows.append([*data.qpos, -s[4], s[0], -s[2]])
        for i in range(substeps):
            data.qfrc_applied[1] = now + (following - now) * (i + 0.5) / substeps
            mujoco.mj_step(model, data)
    return np.array(rows)


def wave(count: int) -> np.ndarray:
    t = np.arange(count) * 0.01
    return 0.4 * np.sin(3.0 * t) + 0.3 * np.sin(7.0 * t + 1.0)


def test_plain_leg_and_imu_agree_with_mujoco() -> None:
    leg, tau = smooth(Leg()), wave(500)
    motion = integrate(leg, tau[:, None], step=5e-4)
    still = np.zeros(tau.size)
    seen = np.column_stack([motion.q1, motion.q2, *imu(motion.q1[:, 0], motion.w1[:, 0], motion.a1[:, 0],
                                                       still, still, 0.2)])
    truth = mujoco_rows(leg, tau, 80)
    assert np.abs(truth[:, 1]).max() > 0.8
    assert_allclose(seen, truth, atol=1e-6, rtol=0)


def test_stiff_shaft_is_an_armature() -> None:
    leg, tau = smooth(Leg()), wave(100)
    motion = integrate(leg, tau[:, None], step=2.5e-4,
                       extra={"shaft": 2e4, "shaft_damping": 5.0, "motor_inertia": 0.01})
    truth = mujoco_rows(leg, tau, 20, armature=0.01)
    assert_allclose(motion.q2[:, 0], truth[:, 1], atol=2e-3)
    plain = mujoco_rows(leg, tau, 20)
    assert np.abs(plain[:, 1] - truth[:, 1]).max() > 0.05


def test_friction_converges_with_the_step() -> None:
    tau = np.array([draw(default_rng(k), kind).at(np.arange(150.0) * 0.01)
                    for k, kind in enumerate(PATTERN)]).T
    coarse, fine = integrate(Leg(), tau), integrate(Leg(), tau, step=2.5e-4)
    # a tenth of what process torque makes of a free run, and below one count of the encoder
    assert np.sqrt(np.mean((coarse.q2 - fine.q2) ** 2)) < 2e-4
    assert np.sqrt(np.mean((coarse.w1 - fine.w1) ** 2)) < 1e-3


def test_dry_friction_sticks_and_slides_at_its_level() -> None:
    leg = Leg(viscous1=0.0, viscous2=0.0)
    # below breakaway at rest: nothing moves; pivot held by its friction too
    held = integrate(leg, np.full((150, 1), 0.02), step=5e-4)
    assert np.abs(held.q2).max() < 4e-3 and np.abs(held.w2[100:]).max() < 1e-3
    # asymmetry brakes the positive direction only
    tau = np.full((30, 2), 0.3) * np.array([1.0, -1.0])
    skewed = integrate(leg, tau, extra={"asymmetry2": 0.1})
    assert abs(skewed.q2[-1, 0]) < 0.8 * abs(skewed.q2[-1, 1])
    dragged = integrate(leg, tau, extra={"asymmetric_drag2": 0.05})
    assert abs(dragged.q2[-1, 0]) < 0.9 * abs(dragged.q2[-1, 1])
    assert np.array_equal(dragged.q2[:, 1], integrate(leg, tau).q2[:, 1])


def test_energy_is_kept_without_friction_on_floor_and_base() -> None:
    """A free swing keeps kinetic plus potential energy, the base's included."""
    leg = Leg(viscous1=0.0, viscous2=0.0, coulomb1=0.0, coulomb2=0.0)
    start = np.array([[0.5], [0.6], [0.0], [0.0]])
    b4, b5 = leg.beta()[3:5]
    # on the floor, on a springy base, and without any horizontal spring
    for base, stiffness in ((0.0, 0.0), (4.0, 200.0), (4.0, 0.0)):
        m = integrate(leg, np.zeros((120, 1)), start=start,
                      extra={"base_mass": base, "base_stiffness": stiffness, "base_damping": 0.0})
        speed = cumulative_simpson(m.base_acceleration, dx=0.01, axis=0, initial=0.0)
        place = cumulative_simpson(speed, dx=0.01, axis=0, initial=0.0)
        q1, q12, w1, w12 = m.q1, m.q1 + m.q2, m.w1, m.w1 + m.w2
        # by König: link by link, velocity of the centre and rotation
        x1, z1 = speed + leg.c1 * np.cos(q1) * w1, leg.c1 * np.sin(q1) * w1
        x2 = speed + leg.l1 * np.cos(q1) * w1 + leg.c2 * np.cos(q12) * w12
        z2 = leg.l1 * np.sin(q1) * w1 + leg.c2 * np.sin(q12) * w12
        energy = (0.5 * base * speed**2 + 0.5 * stiffness * place**2
                  + 0.5 * leg.m1 * (x1**2 + z1**2) + 0.5 * leg.i1 * w1**2
                  + 0.5 * leg.m2 * (x2**2 + z2**2) + 0.5 * leg.i2 * w12**2
                  - 9.81 * (b4 * np.cos(q1) + b5 * np.cos(q12)))
        assert np.ptp(energy) < (1e-4 * np.ptp(0.5 * leg.m1 * (x1**2 + z1**2)) if base else 1e-7)


def test_lanes_do_not_mix() -> None:
    tau = np.tile(wave(60)[:, None], (1, 3))
    together = integrate(Leg(), tau, extra={"spring2": np.array([0.0, 0.5, 0.0]), "shaft": np.array([0, 0, 80.0]),
                                            "motor_inertia": np.array([0, 0, 0.002])})
    alone = integrate(Leg(), tau[:, :1])
    assert_allclose(together.q2[:, 0], alone.q2[:, 0], atol=1e-13)
    assert np.abs(together.q2[:, 1] - alone.q2[:, 0]).max() > 1e-3
    assert np.abs(together.encoder[:, 2] - together.q2[:, 2]).max() > 1e-3
    assert_array_equal(together.encoder[:, :2], together.q2[:, :2])


def test_sensor_faults_have_the_contract_s_signs() -> None:
    tau = wave(60)[:, None]
    motion = integrate(Leg(), tau, fast=np.array([0]))

    def seen(**faults: float) -> dict[str, np.ndarray]:
        return read(motion, 0, tau[:, 0], faults, Sensors())

    clean, late = seen(), seen(skew=0.02)
    # the IMU is late: what it shows now was true two samples ago
    assert_allclose(late["gyro_radps"][2:], clean["gyro_radps"][:-2], atol=1e-9)
    assert_array_equal(late["q2_rad"], clean["q2_rad"])
    biased = seen(gyro_bias=0.1, gyro_scale=0.05)
    assert_allclose(biased["gyro_radps"], 1.05 * clean["gyro_radps"] + 0.1)
    turned = seen(misalignment=0.03)
    norm = np.hypot(clean["accel_x_mps2"], clean["accel_y_mps2"])
    assert_allclose(np.hypot(turned["accel_x_mps2"], turned["accel_y_mps2"]), norm)
    moved = seen(lever=0.01)
    assert_allclose(moved["accel_x_mps2"] - clean["accel_x_mps2"], 0.01 * motion.a1[:, 0])
    once = seen(eccentricity=0.02, eccentricity_phase=0.4)
    assert_allclose(once["q2_rad"] - clean["q2_rad"], 0.02 * np.sin(motion.q2[:, 0] + 0.4), atol=2.1e-4)


def test_measured_torque_is_late_by_the_delay() -> None:
    rig = draw_case(Case("single", ("torque_delay",), seed=3), strengths(), 0.03)
    grid = np.arange(600) / 100.0
    shown = rig.torques[0].at(grid, rig.scale)
    assert_allclose(shown[3:], bench._acting(rig, 0, shown, grid)[:-3], atol=1e-9)


def test_every_effect_of_the_contract_is_here_and_well_formed() -> None:
    assert len(INSIDE) == 25 and len(OUTSIDE) >= 6
    for name, maker in MAKERS.items():
        hidden = maker(strengths()[name], default_rng(1))
        assert set(hidden.plant) <= set(COEFFICIENTS)
        assert hidden.plant or hidden.drive or hidden.sense or hidden.leg
        assert strengths()[name] <= LARGEST.get(name, np.inf)
        assert hidden.sizes and all(np.isfinite(s.value) for s in hidden.sizes)


def test_every_plant_effect_moves_the_leg() -> None:
    """Each effect changes the motion (or the readings), and nothing diverges."""
    tau = np.tile(1.2 * wave(100)[:, None], (1, len(MAKERS) + 1))
    extra: dict[str, np.ndarray] = {}
    lanes = {}
    for k, (name, maker) in enumerate(MAKERS.items()):
        plant = maker(min(2.0 * strengths()[name], LARGEST.get(name, np.inf)), default_rng(2)).plant
        if plant and name != "end_stop_contact":
            lanes[name] = k
        for key, value in plant.items():
            extra.setdefault(key, np.zeros(len(MAKERS) + 1))[k] = value
    motion = integrate(Leg(), tau, extra=extra)
    assert np.abs(motion.q2).max() < 4.0
    for name, k in lanes.items():
        assert np.abs(motion.q2[:, k] - motion.q2[:, -1]).max() > 1e-4, name


def test_coloured_noise_has_its_rms_and_correlation() -> None:
    x = coloured(default_rng(0), 200_000, 0.02, 0.2)
    assert np.std(x) == approx(0.02, rel=0.03)
    assert np.mean(x[20:] * x[:-20]) / np.var(x) == approx(np.exp(-1.0), abs=0.03)


def test_excitation_is_odd_and_bounded() -> None:
    run = draw(default_rng(4), "big")
    grid = np.arange(0.0, 20.0, 0.01)
    spectrum = np.abs(np.fft.rfft(run.at(grid)))
    excited = np.flatnonzero(spectrum > 1e-6 * spectrum.max())
    assert np.all(excited % 2 == 1) and excited.min() >= 2 and excited.max() <= 60
    assert np.abs(run.at(grid)).max() == approx(1.0)


@fixture(scope="module")
def cases(module_path: Path) -> tuple[Path, list[dict[str, Any]]]:
    chosen = [Case("none", seed=2), Case("single", ("torque_offset",), "large", 1),
              Case("single", ("sensor_time_skew",), seed=1), Case("outside", ("loose_payload",), seed=1)]
    return module_path, bench.generate(chosen, module_path, samples=300, step=1e-3)


def test_files_are_the_contract_s_and_hold_no_truth(cases: tuple[Path, list[dict[str, Any]]]) -> None:
    root, truths = cases
    for truth in truths:
        folder = root / truth["name"]
        assert sorted(p.name for p in folder.iterdir()) == [*(f"r{k}.csv" for k in range(1, 9)), "rig.toml"]
        assert json.loads((root / f"{truth['name']}.truth.json").read_text()) == truth
        rig = load_rig(folder / "rig.toml")
        assert rig.sampling.hold == "linear" and rig.noise.encoder_rad is not None
        for path in folder.glob("*.csv"):
            assert path.read_text().splitlines()[0] == ",".join(COLUMNS)
        table = np.loadtxt(folder / "r1.csv", delimiter=",", skiprows=1)
        assert table.shape == (300, 6) and np.isfinite(table).all()
        count = 2 * np.pi / 2 ** truth["sensors"]["bits"]
        assert np.abs(table[:, 1] / count - np.round(table[:, 1] / count)).max() < 1e-4
        assert truth["largest"]["q2_rad"] < 2.0 and truth["largest"]["q1_rad"] < 1.0
    assert truths[0]["effects"] == [] and truths[0]["variant"] == "coarse"
    assert truths[0]["ratio"] == approx(1.0, abs=0.05)
    assert truths[2]["ratio"] == approx(3.3, abs=1.2)


def test_a_case_comes_again_from_its_seed(cases: tuple[Path, list[dict[str, Any]]], tmp_path: Path) -> None:
    root, _ = cases
    bench.generate([Case("single", ("torque_offset",), "large", 1)], tmp_path, samples=300, step=1e-3)
    again, before = (np.loadtxt(p / "single-torque_offset-large-1" / "r4.csv", delimiter=",", skiprows=1)
                     for p in (tmp_path, root))
    assert_allclose(again, before, atol=2e-3)
    other = draw_case(Case("single", ("torque_offset",), "large", 2), strengths())
    assert other.leg != draw_case(Case("single", ("torque_offset",), "large", 1), strengths()).leg


def test_no_generator_imports_the_estimator() -> None:
    for path in (BLIND / f"{name}.py" for name in GENERATORS):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else \
                [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] in ("estimator", "experiments", "drivers") for n in names), path


def _outcome(hidden: list[dict[str, Any]], verdict: str, causes: list[str]) -> Outcome:
    said = [{"effect": c, "joint": 2, "size": [{"name": "torque", "unit": "N m", "value": 0.05, "ci95": [0.04, 0.06]}]}
            for c in causes]
    return Outcome({"name": "x", "effects": hidden}, verdict, tuple(said))


def _hidden(name: str, **more: Any) -> dict[str, Any]:
    return {"effect": name, "joint": 2, "also": [], **more}


@mark.parametrize("verdict, causes, exact, inside, wrong", [
    ("named", ["backlash"], True, True, False), ("partial", ["backlash"], True, True, False),
    ("one_of", ["backlash", "presliding_friction"], False, True, False),
    ("named", ["torque_delay"], False, False, True), ("named", ["backlash", "torque_delay"], False, True, True),
    ("one_of", ["torque_delay"], False, False, False), ("unexplained", ["backlash"], False, False, False),
    ("named", ["backlash", "rotor_inertia"], True, True, False)])
def test_an_answer_is_exact_has_the_truth_in_it_or_a_wrong_name(
        verdict: str, causes: list[str], exact: bool, inside: bool, wrong: bool) -> None:
    found = _outcome([_hidden("backlash", also=[{"effect": "rotor_inertia", "joint": None}])], verdict, causes)
    assert (found.exact, found.inside, found.wrong_name) == (exact, inside, wrong)


def test_a_pair_is_named_by_both_of_its_effects() -> None:
    both = [_hidden("backlash"), _hidden("torque_delay")]
    assert _outcome(both, "named", ["backlash", "torque_delay"]).exact
    assert not _outcome(both, "named", ["backlash"]).exact and not _outcome(both, "named", ["backlash"]).wrong_name


def test_sizes_are_compared_by_name_by_unit_or_as_the_only_ones() -> None:
    def sized(effect: str, **sizes: Any) -> list[bool]:
        return sizes_inside(_outcome([_hidden(effect, **sizes)], "named", [effect]))

    def size(name: str, unit: str, value: float) -> dict[str, Any]:
        return {"name": name, "unit": unit, "value": value}

    assert sized("torque_offset", size=[size("torque", "?", 0.05)]) == [True]
    assert sized("torque_offset", size=[size("level", "N m", 0.07)]) == [False]
    assert sized("torque_offset", size=[size("level", "N m", 0.05), size("other", "N m", 0.05)]) == []
    assert sized("torque_offset", size=[size("level", "rad", 0.05)]) == []
    assert sized("torque_offset", sizes={"offset": 0.05}) == [True] and sized("torque_offset", sizes={}) == []
    assert sized("backlash", size=[size("torque", "N m", 0.05)]) == []  # hidden by another law than the library's


def test_wilson_interval_is_the_textbook_s() -> None:
    # Brown, Cai and DasGupta 2001: 0 of 20 gives 0 to 0.1611
    assert Rate(0, 20).interval == approx((0.0, 0.1611), abs=1e-4)
    assert Rate(10, 20).interval[0] == approx(0.2993, abs=1e-4)
