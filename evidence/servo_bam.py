"""The XL330 of Rhoban/bam by BAM's published models and by ours, under its command, on runs that ours has not seen.

BAM's equations are those of its paper (Duclusaud, Passault, Padois, Ly, ICRA 2025) and of bam/model.py, its values
those of params/xl330 at commit af22604622. They were found on records that may have these runs among them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

import legid
from daq import Dataset, FloatArray, Loop, Rig, load_rig
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import fit_nominal, refit
from estimator.effects import classes
from estimator.free_runs import FittedModel
from estimator.likelihood import free_run
from estimator.loops import law_checks
from estimator.options import FitOptions
from estimator.prediction import smooth
from evidence.kept import kept
from experiments.documents import finite
from experiments.models import build_mechanism, mechanism_settings
from experiments.session import as_datasets, prepare
from tests.support.paths import REAL, ROOT

FOLDER, RIG = REAL / "bam_xl330", ROOT / "studies/rigs/bam_xl330_diagnose.toml"
TRAIN = ("sin_sin", "up_and_down", "lift_and_drop")
TEST = ("sin_time_square",)
MASS_KG, ARM_M, G, STEP_S = 0.49, 0.1, 9.81, 5e-4
EFFECTS = ("load_dependent_friction", "directional_load_friction")
"""That are fitted together with Coulomb and viscous friction"""
PUBLISHED: dict[str, dict[str, float]] = {
    "m1": {"kt": 0.323211, "R": 4.76365, "armature": 0.00164322, "q_offset": 0.0179525, "friction_base": 0.00696597,
           "friction_viscous": 0.0104948},
    "m2": {"kt": 0.300072, "R": 3.42235, "armature": 0.00183519, "q_offset": 0.0225922, "friction_base": 0.00198862,
           "friction_viscous": 0.0119552, "friction_stribeck": 0.00558535, "dtheta_stribeck": 1.95062,
           "alpha": 1.69141},
    "m6": {"kt": 0.30361, "R": 2.44495, "armature": 0.0020566, "q_offset": 0.0211356, "friction_base": 0.000449624,
           "friction_viscous": 0.00817865, "friction_stribeck": 8.98237e-05, "dtheta_stribeck": 0.7792,
           "alpha": 1.81215, "load_friction_motor": 0.284251, "load_friction_external": 0.136314,
           "load_friction_motor_stribeck": 0.000962296, "load_friction_external_stribeck": 0.0775627,
           "load_friction_motor_quad": 0.00525869, "load_friction_external_quad": 0.0090157}}


def rig() -> Rig:
    """The rig file of the records."""
    return load_rig(RIG)


def records(kinds: tuple[str, ...]) -> list[Dataset]:
    """Runs with their command as the contract names it; `lift_and_drop` switches the motor off."""
    paths = [FOLDER / f"kp{gain}_{kind}.csv.gz" for kind in kinds for gain in (100, 400)]
    return [replace(d, columns={("q1_cmd_rad" if n == "goal_rad" else n): v for n, v in d.columns.items()})
            for d in as_datasets(paths, load_rig(RIG))]


def friction(p: Mapping[str, float], motor: float, load: float, rate: float) -> float:
    """Largest friction torque [N m] by BAM's models, viscous part included."""
    near = float(np.exp(-(abs(rate / p["dtheta_stribeck"]) ** p["alpha"]))) if "alpha" in p else 0.0
    loss = p["friction_base"] + near * p.get("friction_stribeck", 0.0)
    if "load_friction_motor" in p:
        loss += abs(load * p["load_friction_external"] - motor * p["load_friction_motor"])
        loss += near * abs(load * p["load_friction_external_stribeck"] - motor * p["load_friction_motor_stribeck"])
        if np.sign(load) != np.sign(motor):
            by = p["load_friction_external_quad"] * load**2 if abs(load) < abs(motor) else \
                p["load_friction_motor_quad"] * motor**2
            loss += near * by
    return loss + p["friction_viscous"] * abs(rate)


def by_bam(p: Mapping[str, float], run: Dataset, gain: float, sign: float) -> FloatArray:
    """(N,) angle of BAM's model under the command, from the first reading at rest; `sign` is that of q_offset."""
    fine = np.arange(0.0, run.time_s[-1] - run.time_s[0], STEP_S)
    goal, volts = (np.interp(fine, run.time_s - run.time_s[0], run[name]) for name in ("q1_cmd_rad", "volts"))
    q, v, inertia, out = float(run["q1_rad"][0]), 0.0, MASS_KG * ARM_M**2 + p["armature"], np.empty(fine.size)
    for k in range(fine.size):
        out[k] = q
        duty = min(max(gain * (goal[k] - q), -1.0), 1.0)
        motor = p["kt"] / p["R"] * (volts[k] * duty - p["kt"] * v)
        load = -MASS_KG * G * ARM_M * float(np.sin(q + sign * p["q_offset"]))
        net, most = motor + load, friction(p, motor, load, v)
        stop = -(inertia * v / STEP_S + net)  # the torque that stops the joint within the step
        v += STEP_S / inertia * (net + min(max(stop, -most), most))
        q += STEP_S * v
    return np.interp(run.time_s - run.time_s[0], fine, out)


def closed(model: FittedModel, run: Dataset, gain: float) -> FloatArray:
    """(N,) angle of our model under the command."""
    looped = replace(run, loops={1: Loop(gain=gain, limit=1.0, supply=np.nan)})
    one = smooth(model, looped, FitOptions(sensors="encoder", noise={"encoder_rad": 0.002}))
    found = free_run(one.problem, one.state, one.drive)
    assert one.problem.closed
    return np.full(len(run), np.nan) if found is None else np.asarray(found.q[:, 0])


@kept
def fits() -> dict[str, tuple[FittedModel, FloatArray]]:
    """Estimator to our model of the train runs, and half of the 95 % interval of each parameter, in volts."""
    rig, train, found = load_rig(RIG), records(TRAIN), {}
    for method in ("wls", "mle"):
        result = legid.fit(train, rig, choose=False, method=method).estimate  # values, open or not
        found[method] = FittedModel(result.mechanism, rig.sampling.hold, result.beta), 1.96 * result.std
    return found


@kept
def extended(name: str) -> FittedModel:
    """Our model of the train runs with one effect of the library, in volts."""
    setup = prepare(records(TRAIN), rig(), choose=False).setup
    split = split_runs(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio)
    nominal = fit_nominal(replace(split, train=tuple(range(len(setup.datasets))), test=()))
    (kind,) = (one for one in classes() if one.name == name)
    begin = np.array([0.1, *[0.0] * (len(kind.sizes) - 1), *(shape.grid[1] for shape in kind.shapes)])
    return refit(nominal, [(kind(0), begin)], 60).fitted


@kept
def errors() -> dict[str, list[float]]:
    """Model to the rms error [rad] on each test run."""
    test = records(TEST)
    (check,) = law_checks(test, build_mechanism(mechanism_settings(load_rig(RIG))))
    out: dict[str, list[float]] = {}
    for run, gain in zip(test, check.after.gains):
        ours = {f"legid, {name}: Coulomb and viscous": model for name, (model, _) in fits().items()}
        ours |= {f"legid, mle: and {name}": extended(name) for name in EFFECTS}
        for name, model in ours.items():
            out.setdefault(name, []).append(_rms(closed(model, run, float(gain)) - run["q1_rad"]))
        for name, values in PUBLISHED.items():
            both = [_rms(by_bam(values, run, float(gain), sign) - run["q1_rad"]) for sign in (1.0, -1.0)]
            out.setdefault(f"BAM {name}", []).append(min(both))
    return out


def in_volts(p: Mapping[str, float]) -> tuple[float, float, float]:
    """Inertia, first moment and viscous friction of BAM's values as ours are, over the motor's R / kt."""
    scale = p["R"] / p["kt"]
    return (scale * (MASS_KG * ARM_M**2 + p["armature"]), scale * MASS_KG * ARM_M,
            p["kt"] + scale * p["friction_viscous"])


def _std(model: FittedModel) -> FloatArray:
    """(m,) of all parameters, by noise alone."""
    assert model.covariance is not None
    return np.sqrt(np.diag(model.covariance))


def shares() -> dict[str, tuple[float, float, float, float]]:
    """BAM's names of friction by load in motion -> what the directional law finds with its 95 % interval, lowest first,
    and m6's published value."""
    model, p = extended("directional_load_friction"), PUBLISHED["m6"]
    (k, _, share, _), at = model.parameters[model.mechanism.p :], [model.mechanism.p, model.mechanism.p + 2]
    assert model.covariance is not None
    out = {}
    for name, value, slope in (("load_friction_motor", k * (1.0 - share), np.array([1.0 - share, -k])),
                               ("load_friction_external", k * share, np.array([share, k]))):
        half = 1.96 * float(np.sqrt(slope @ model.covariance[np.ix_(at, at)] @ slope))
        out[name] = float(value - half), float(value), float(value + half), p[name]
    return out


@kept
def diagnosis() -> tuple[str, tuple[str, ...], tuple[float, float] | None]:
    """Verdict, causes, and error over noise before and after, of the train runs."""
    found = legid.diagnose(records(TRAIN), rig(), workers=1)
    error = found.error
    return found.verdict, tuple(cause.effect for cause in found.causes), (
        None if error is None else (finite(error.before), finite(error.after)))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def parameters() -> Iterator[str]:
    """Lines of the page on parameters in volts."""
    yield from ["| model, in volts | inertia | first moment | viscous, back-EMF included |",
                "| --- | --- | --- | --- |"]
    ours = {f"legid, {name}": (model, half[:3]) for name, (model, half) in fits().items()}
    ours |= {f"legid, mle: and {name}": (extended(name), 1.96 * _std(extended(name))[:3]) for name in EFFECTS}
    for name, (model, half) in ours.items():
        yield f"| {name} | " + " | ".join(f"{v:.3g} ± {h:.2g}" for v, h in zip(model.beta[:3], half)) + " |"
    for name, p in PUBLISHED.items():
        yield f"| BAM {name} | " + " | ".join(f"{v:.3g}" for v in in_volts(p)) + " |"
