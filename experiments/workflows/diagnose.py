"""A diagnosis of run files: checks before it, and what a saved model needs in addition."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from daq import Dataset, InputError, Rig
from daq.runs import IMU
from estimator import FitError
from estimator.calibration import differing_text, find_differing
from estimator.diagnosis import MATERIAL, Diagnosis, diagnose, with_law
from estimator.loops import corrected_readings, law_checks, volts_of
from estimator.signals import angle_column
from experiments.models import Model, known_effects, values_of
from experiments.session import Prepared, Setup, require_one_rig, require_sound, wanted_terms

BENCHMARK = "q1_rad"
GAIN = "torque_gain"


def diagnose_prepared(prepared: Prepared, seed: int = 0, reference: Mapping[str, tuple[float, float]] | None = None,
                   progress: Callable[[str, float], None] | None = None, workers: int | None = None,
                   material: float = MATERIAL) -> Diagnosis:
    """The diagnosis of the runs of `prepared`, in the order given, on `workers` processes (by default one a core).

    Columns that contradict each other give the verdict fit_failed with a remedy. Raises `InputError` for runs that do
    not belong together.
    """
    known_effects()
    setup, rig = prepared.setup, prepared.rig
    notes = (*prepared.warnings, *setup.notes)
    imus = setup.mechanism.imus
    if setup.options.sensors == "imu" and len(imus) > 1:
        raise InputError("the rig file", f"has {len(imus)} IMUs; a diagnosis knows the faults of one",
                         "diagnose with one [[imu]] in a copy of the rig file, and encoders of the other joints")
    require_one_rig(setup.datasets)
    require_alike(setup.datasets)
    if setup.options.prior:
        notes = (*notes, "[prior] is not used: a diagnosis judges the model by these runs alone")
        setup = replace(setup, options=replace(setup.options, prior={}))
    setup = without_benchmark(setup)
    try:
        require_sound(setup)
    except FitError as error:
        return Diagnosis("fit_failed", f"No diagnosis: {error}.", warnings=notes, material=material)
    options = replace(setup.options, tolerances=setup.tolerances)
    datasets, checks = setup.datasets, law_checks(setup.datasets, setup.mechanism)
    for check in checks:
        datasets = corrected_readings(datasets, setup.mechanism, check.joint, check.after.faults)
    found = diagnose(datasets, setup.mechanism, options, gear_ratio=rig.motor.gear_ratio, seed=seed,
                     progress=progress, reference=reference, workers=workers, material=material,
                     terms=partial(wanted_terms, setup, rig))
    found = with_law(found, checks, setup.mechanism, volts_of(datasets))
    if reference is not None and found.verdict == "fit_failed":
        found = replace(found, sentence=f"{found.sentence} The reference was not compared: that needs a fit of these "
                        "runs. legid validate says how well the reference predicts them.")
    differing = None if rig.terms.encoder_zero else find_differing(setup.datasets, setup.mechanism, setup.options)
    told = () if differing is None else (differing_text(differing, setup.mechanism.length_unit),)
    return replace(found, not_testable=with_known_gain(found.not_testable, rig),
                   warnings=(*found.warnings, *notes, *told))


def with_known_gain(not_testable: Mapping[str, str], rig: Rig) -> dict[str, str]:
    """`found` with effects that motion cannot test, and the torque gain by a known weight where the rig file has it."""
    c = rig.calibration
    half = c.torque_constant_half_nm_per_a
    if half is None or GAIN not in not_testable:
        return dict(not_testable)
    constant = c.torque_constant_nm_per_a
    words = (f"measured by a known weight, {constant:.4g} +- {half:.2g} N m/A (95 %): all parameters' common scale is "
             f"known to {half / constant:.2%}; motion does not determine it")
    return {**not_testable, GAIN: words}


def without_benchmark(setup: Setup) -> Setup:
    """`setup` without angles of unused encoders, such as the pivot's on a rig with an IMU.

    A diagnosis must not read them.
    """
    m, used = setup.mechanism, setup.options.encoders_of(setup.mechanism.n)
    hidden = {angle_column(m, j) for j in range(m.n) if j not in used}
    return setup if not hidden else replace(setup, datasets=tuple(
        replace(data, columns={name: values for name, values in data.columns.items() if name not in hidden})
        for data in setup.datasets))


def require_alike(datasets: Sequence[Dataset]) -> None:
    """Raises `InputError` where runs differ in the columns that a diagnosis reads, or where one is given twice."""
    first = datasets[0]
    for k, data in enumerate(datasets):
        for name in sorted({*IMU, *_motion(first), *_motion(data)}):
            if (name in data) != (name in first):
                has, lacks = (data, first) if name in data else (first, data)
                raise InputError(lacks.name, f"has no column {name}, {has.name} has", "give runs of one rig")
        if any(data.name == other.name and len(data) == len(other) and all(
                name in other and (data[name] == other[name]).all() for name in data.columns)
               for other in datasets[:k]):
            raise InputError(data.name, "is given twice", "give every run once: runs count as independent")


def _motion(data: Dataset) -> set[str]:
    """Columns that hold angles and torques, the pivot's benchmark left out where an IMU stands in for it."""
    imu = all(name in data for name in IMU)
    return {name for name in data.columns if name.startswith(("q", "tau"))
            and not name.endswith(("cmd_nm", "motor_rad", "shunt_nm")) and not (imu and name == BENCHMARK)}


def reference_values(model: Model, where: str, setup: Setup) -> dict[str, tuple[float, float]]:
    """(value, std) by parameter of an earlier model. Raises `InputError` for one of another mechanism."""
    values = values_of(model)
    if tuple(values) != setup.mechanism.names:
        raise InputError(where, f"is a model of {model.mechanism.model} with other parameters than the rig's",
                         "give a model that was fitted on this rig, or its rotor_inertia and torque_offset under "
                         "[terms]")
    return values
