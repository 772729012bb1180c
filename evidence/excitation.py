"""Chirp and designed plan of one length and one set of limits, by refits on the emulated leg.

    python -m evidence excitation [--seconds 20] [--seeds 8] [--limits wide tight]

It writes what stands under "Limits" in docs/evidence/excitation.md.

Every plan goes through the emulated chips, drivers, recorder and the default fit, once a seed. The designs see a prior
model that is wrong by 20 % in every parameter, up or down by a drawn sign; the chirp is as large as that
same prior allows within the same share of the same limits. For every plan, models 20 % away from the prior keep the
whole limits.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from daq import FloatArray, Limits, Rig, parse_rig
from daq.recording import Plan
from estimator import fit
from evidence.frame import Lines, new_folder, program, table
from evidence.kept import kept
from evidence.registry import Evidence
from experiments.emulation import LegBody, record_emulated
from experiments.excite import Band, Bench, Search, design
from experiments.excite.optimal_design import RATE_HZ, TAPER_S, Candidate
from experiments.models import MechanismSettings, Model, ParameterValue, Provenance, build_mechanism
from experiments.session import prepare
from tests.support.paths import DEMO_RIG

WRONG = 0.2
MARGIN = 0.8
PRIOR_SEED = 5
NOISE = {"torque_nm": 0.0076, "encoder_rad": 1e-4, "gyro_radps": 0.0031, "accel_mps2": 0.04}
"""Of the prior model: what fits of this rig find."""
LIMITS = {"wide": Limits(torque_nm=2.0, speed_radps=25.0, q1_rad=1.5, q2_rad=3.0),
          "tight": Limits(torque_nm=1.5, speed_radps=8.0, q1_rad=0.6, q2_rad=1.2)}
"""Those of the demo's rig, and those of a leg between close stops."""

USUAL = "chirp 0.1-5 Hz"
DESIGNS = ("design, d", "design, worst")


class Refits(NamedTuple):
    """Fits of one plan's runs."""

    plan: Plan
    std: FloatArray
    """(seeds, p) standard errors that the fits state."""
    error: FloatArray
    """(seeds, p) estimate minus truth."""


def prior_model(body: LegBody) -> Model:
    """The leg's parameters, each 20 % off."""
    sign = np.sign(np.random.default_rng(PRIOR_SEED).standard_normal(9))
    settings = MechanismSettings(model="leg2", actuated=(2,), lever_arm_m=0.2)
    values = np.array(body.beta()) * (1.0 + WRONG * sign)
    parameters = tuple(ParameterValue(name=p.name, meaning=p.meaning, unit=p.unit, value=float(v))
                       for p, v in zip(build_mechanism(settings).parameters, values))
    return Model(schema="legid.model/1", mechanism=settings, parameters=parameters, noise=NOISE, hold="zero",
                 covariance=tuple((None,) * 9 for _ in range(9)),
                 provenance=Provenance(runs=(), method="mle", sensors="imu", date="", version=""))


def chirp(seconds: float, low_hz: float, high_hz: float) -> FloatArray:
    """Unit chirp, its ends faded; frequency rises evenly in time."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = np.sin(2 * np.pi * (low_hz * t + (high_hz - low_hz) * t**2 / (2 * seconds)))
    wave *= np.clip(np.minimum(t, t[-1] - t) / TAPER_S, 0.0, 1.0)
    return wave / np.abs(wave).max()


def plans(bench: Bench, seconds: float) -> dict[str, Candidate]:
    """Name -> plan, all within the same limits by the same prior."""
    usual = bench.sized(chirp(seconds, 0.1, 5.0), MARGIN)
    if usual is None:
        raise SystemExit("no size of the chirp keeps the limits")
    return {USUAL: usual} | {name: design(bench, Band(seconds, 0.0, 3.0), Search(
        margin=MARGIN, criterion=name.removeprefix("design, "))).best for name in DESIGNS}


@kept
def refit(plan: Plan, rig: Rig, rig_text: str, seeds: Sequence[int], body: LegBody) -> Refits:
    """Record on the emulated leg and fit, once a seed."""
    truth, std, error = np.array(body.beta()), [], []
    for seed in seeds:
        with new_folder() as folder:
            path = folder / "run.mcap"
            record_emulated(path, rig, rig_text, plan, seed, body)  # raises where the leg leaves the limits
            setup = prepare([path], rig).setup
        found = fit(setup.datasets, setup.mechanism, setup.options)
        if not found.converged:
            raise SystemExit(f"seed {seed}: the fit did not converge")
        std.append(found.std)
        error.append(found.beta - truth)
    return Refits(plan, np.array(std), np.array(error))


def section(name: str, limits: Limits, seconds: float, seeds: Sequence[int]) -> Lines:
    """Lines on one set of limits."""
    text = DEMO_RIG.read_text()
    for key in ("torque_nm", "speed_radps", "q1_rad", "q2_rad"):
        text = re.sub(rf"^{key} = .*$", f"{key} = {getattr(limits, key)}", text, flags=re.MULTILINE)
    rig = parse_rig(text, "demo_rig.toml")
    body = LegBody()
    truth = np.array(body.beta())
    bench = Bench(prior_model(body), rig, "prior", WRONG)
    names = bench.mechanism.names
    candidates = plans(bench, seconds)
    found = {kind: refit(c.plan, rig, text, seeds, body) for kind, c in candidates.items()}
    per_minute = 100.0 * np.sqrt(seconds / 60.0) / truth
    stated = {kind: per_minute * r.std.mean(axis=0) for kind, r in found.items()}
    actual = {kind: per_minute * np.sqrt(np.mean(r.error**2, axis=0)) for kind, r in found.items()}
    floor = 100.0 * NOISE["torque_nm"] / np.sqrt(60.0 * rig.sampling.planned_hz) / truth[-1]
    yield (f"## Limits {name}: {limits.torque_nm:g} N m, {limits.speed_radps:g} rad/s, q1 {limits.q1_rad:g} rad, "
           f"q2 {limits.q2_rad:g} rad")
    for caption, rows in (("Standard error that the refits state", stated),
                          ("Root mean square of the refits' errors about the truth", actual)):
        yield f"{caption}, for one minute of experiment, per cent of the value"
        yield table(f" | {' | '.join(names)} | largest", (
            (kind, *(f"{value:.3f}" for value in (*row, row.max()))) for kind, row in rows.items()))
    yield table("design | against | its worst parameter | of its error, stated and actual | largest against "
                "largest | geometric mean", (
        _against(kind, stated, actual, names) for kind in DESIGNS))
    off = np.concatenate([(r.error / r.std).ravel() for r in found.values()])
    yield from [
        f"- Errors over the standard errors that go with them, all plans, seeds and parameters: root mean square "
        f"{np.sqrt(np.mean(off**2)):.2f}.",
        f"- No plan can state less than {floor:.2f} % for beta9 in a minute, because of torque noise.",
        f"- Plans of {seconds:g} s, noise seeds {seeds[0]} to {seeds[-1]}, prior seed {PRIOR_SEED}."]


def _against(kind: str, stated: dict[str, FloatArray], actual: dict[str, FloatArray], names: Sequence[str]) -> str:
    worst = int(np.argmax(stated[USUAL]))
    ratio, real = stated[kind] / stated[USUAL], actual[kind] / actual[USUAL]
    return (f"{kind} | {USUAL} | {names[worst]} | {ratio[worst]:.2f}, {real[worst]:.2f} "
            f"| {stated[kind].max() / stated[USUAL].max():.2f}, {actual[kind].max() / actual[USUAL].max():.2f} "
            f"| {np.exp(np.log(ratio).mean()):.2f}, {np.exp(np.log(real).mean()):.2f}")


def page(seconds: float = 20.0, seeds: int = 8, limits: Sequence[str] = tuple(LIMITS)) -> Lines:
    yield "# A designed plan against a chirp"
    for name in limits:
        yield from section(name, LIMITS[name], seconds, range(1, seeds + 1))


EVIDENCE = Evidence(
    "A designed plan against a chirp of the same length and limits, by refits",
    "python -m evidence excitation", "excitation.md", 16, "half of the chirp's worst standard error",
    (r"largest actual error against largest, default design \| \S+ \| \S+",),
    r"noise seeds (\d+ to \d+)")
main = program(page)
