"""The XL330 of Rhoban/bam by our models under its command, on runs that they have not seen, and BAM's published values.

The values are those of params/xl330 at commit af22604622. They were found on records that may have these runs among
them.
"""

from dataclasses import replace
from functools import cache

import numpy as np

import legid
from daq import Dataset, FloatArray, Loop, Rig, load_rig
from estimator import FitOptions
from estimator.diagnosis.data_split import split_runs
from estimator.diagnosis.model import nominal_model, refit
from estimator.effects import classes
from estimator.free_runs import FittedModel
from estimator.likelihood import free_run
from estimator.loops import law_checks
from estimator.prediction import smooth
from evidence.kept import kept
from experiments.documents import finite
from experiments.models import build_mechanism, mechanism_settings
from experiments.session import as_datasets, prepare
from tests.support.paths import REAL, ROOT

FOLDER, RIG = REAL / "bam_xl330", ROOT / "studies/rigs/bam_xl330_diagnose.toml"
TRAIN = ("sin_sin", "up_and_down", "lift_and_drop")
TEST = ("sin_time_square",)
MASS_KG, ARM_M = 0.49, 0.1
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


@cache
def rig() -> Rig:
    """The rig file of the records."""
    return load_rig(RIG)


def records(kinds: tuple[str, ...]) -> list[Dataset]:
    """Runs with their command as the contract names it; `lift_and_drop` switches the motor off."""
    paths = [FOLDER / f"kp{gain}_{kind}.csv.gz" for kind in kinds for gain in (100, 400)]
    return [replace(d, columns={("q1_cmd_rad" if n == "goal_rad" else n): v for n, v in d.columns.items()})
            for d in as_datasets(paths, rig())]


def closed(model: FittedModel, run: Dataset, gain: float) -> FloatArray:
    """(N,) angle of our model under the command."""
    looped = replace(run, loops={1: Loop(gain=gain, limit=1.0, supply=np.nan)})
    one = smooth(model, looped, FitOptions(sensors="encoder", noise={"encoder_rad": 0.002}))
    found = free_run(one.problem, one.state, one.drive)
    assert one.problem.closed
    return np.full(len(run), np.nan) if found is None else np.asarray(found.q[:, 0])


@kept
def fits() -> dict[str, FittedModel]:
    """Estimator to our model of the train runs, in volts."""
    train, found = records(TRAIN), {}
    for method in ("wls", "mle"):
        result = legid.fit(train, rig(), choose=False, method=method).estimate  # values, open or not
        found[method] = FittedModel(result.mechanism, rig().sampling.hold, result.beta)
    return found


@kept
def extended(name: str) -> FittedModel:
    """Our model of the train runs with one effect of the library, in volts."""
    setup = prepare(records(TRAIN), rig(), choose=False).setup
    split = split_runs(setup.datasets, setup.mechanism, setup.options, setup.gear_ratio)
    nominal = nominal_model(replace(split, train=tuple(range(len(setup.datasets))), test=()))
    (kind,) = (one for one in classes() if one.name == name)
    begin = np.array([0.1, *[0.0] * (len(kind.sizes) - 1), *(shape.grid[1] for shape in kind.shapes)])
    return refit(nominal, [(kind(0), begin)], 60).fitted


@kept
def errors() -> dict[str, list[float]]:
    """Model to the rms error [rad] on each test run."""
    test = records(TEST)
    (check,) = law_checks(test, build_mechanism(mechanism_settings(rig())))
    out: dict[str, list[float]] = {}
    for run, gain in zip(test, check.after.gains):
        ours = {f"legid, {name}: Coulomb and viscous": model for name, model in fits().items()}
        ours |= {f"legid, mle: and {name}": extended(name) for name in EFFECTS}
        for name, model in ours.items():
            off = closed(model, run, float(gain)) - run["q1_rad"]
            out.setdefault(name, []).append(float(np.sqrt(np.mean(off**2))))
    return out


@kept
def diagnosis() -> tuple[str, tuple[str, ...], tuple[float, float] | None]:
    """Verdict, causes, and error over noise before and after, of the train runs."""
    found = legid.diagnose(records(TRAIN), rig(), workers=1)
    error = found.error
    return found.verdict, tuple(cause.effect for cause in found.causes), (
        None if error is None else (finite(error.before), finite(error.after)))

