"""`legid excite --separate`: the torque that tells the rivals of a diagnosis apart, within the rig's limits.

T-optimality (Atkinson and Fedorov, Biometrika 62, 1975), linearised at the nominal model. Let rival a be true with
sizes theta_a. Rival b is fitted, with all nominal parameters and the causes that are sure: columns N. Twice the
expected log likelihood ratio of a over b is then

    lambda = theta_a' (I_aa - I_aN (I_NN + P)^-1 I_Na) theta_a,

where I is the information of a run whose motion is eliminated, and P what reference runs tell of the parameters. The
log likelihood ratio is normal with mean lambda / 2 and variance lambda. The search makes the sum of exp(-lambda / 8)
over all ordered pairs small: Chernoff's bound on the probability of a wrong decision.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from math import ceil, log, log2
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.special import logsumexp, ndtri

from daq import Dataset, FloatArray, InputError, WorkError, read_bytes
from estimator import FitError, FitOptions
from estimator.change import known_reference, score_run
from estimator.effects import Effect, placed
from estimator.free_runs import FittedModel
from estimator.likelihood import Candidate as Column
from estimator.likelihood import Noise
from estimator.signals import angle_column, predicted_columns, torque_column
from experiments.excite.fisher_information import Moved
from experiments.excite.limits import as_large_as_allowed
from experiments.excite.optimal_design import (
    RATE_HZ,
    SAMPLES_A_PERIOD,
    USUAL_HIGH_HZ,
    Band,
    Bench,
    Candidate,
    Search,
    Series,
    design,
)
from experiments.excite.waveforms import KINDS
from experiments.models import Model, known_effects

CERTAIN = log(20.0)
"""Log likelihood ratio that settles a pair."""
POWER = 0.9
LEAST = 1e-2
"""Log likelihood ratio of one plan below which nothing is told apart."""
DRAWS = 8
"""Random starts for each of `Search.tries`."""
LINES = 10
"""Most lines of a plan: of more the evolution strategy needs more steps. A longer plan repeats itself."""
STEP, GROW, SHRINK = 0.3, 1.5, 0.9
"""Of the evolution strategy (1 + 1): first step as a share of the plan, and its change after success and failure (one
success in five keeps it)."""
MOST = 3
"""Candidates that are rivals where no cause is named."""
SEPARABLE = ("one_of", "partial", "unexplained", "changed_unexplained")
REMEDY = "give the JSON of legid diagnose --json"


@dataclass(frozen=True)
class Rival:
    """One possible cause: an effect at a joint with its sizes, or a parameter that changed."""

    effect: str
    joint: int | None
    """1-based"""
    sizes: dict[str, float]
    """Sizes and shapes by name."""

    @property
    def label(self) -> str:
        """The effect and where it is, or the parameter."""
        if self.effect == "parameter":
            return next(iter(self.sizes))
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


@dataclass(frozen=True)
class Question:
    """Rivals of a diagnosis, and causes that are present anyway."""

    rivals: tuple[Rival, ...]
    sure: tuple[Rival, ...] = ()
    """Causes that are present anyway."""
    against: bool = False
    """Whether rivals are changes since reference runs."""
    left_out: tuple[str, ...] = ()
    """A line for each rival that the design does not take, with the reason."""


@dataclass(frozen=True)
class Separation:
    """The best plan, and the first draw, which no search has bettered."""

    first: Candidate
    best: Candidate
    pairs: tuple[tuple[str, str], ...]
    before: FloatArray
    """(pairs,) expected log likelihood ratio of one run of the first draw, the smaller of both directions"""
    after: FloatArray
    """(pairs,) of the best plan"""

    @property
    def seconds(self) -> float:
        return self.best.plan.duration_s

    @property
    def apart(self) -> dict[tuple[str, str], float]:
        """Pairs that the best plan tells apart, and their expected log likelihood ratios."""
        return {pair: float(ratio) for pair, ratio in zip(self.pairs, self.after) if ratio >= LEAST}


def question_of(path: Path | str) -> Question:
    """The rivals of a diagnosis JSON. Raises `InputError` where it leaves nothing to separate."""
    where = str(path)
    try:
        found = msgspec.json.decode(read_bytes(path))
    except OSError as error:
        raise InputError(where, error.strerror or str(error), REMEDY) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise InputError(where, "is not JSON", REMEDY) from None
    return question_in(found, where)


def question_in(found: Any, where: str) -> Question:
    """The rivals of the diagnosis document `found`, which errors call `where`. Raises as `question_of`."""
    if not isinstance(found, dict) or found.get("schema") != "legid.diagnosis/1":
        raise InputError(where, "is no legid.diagnosis/1", REMEDY)
    verdict = found.get("verdict")
    if verdict not in SEPARABLE:
        raise InputError(where, f"has the verdict {verdict!r}, which leaves no rivals",
                         "give one that ended one_of, partial or unexplained; --session plans for others")
    try:
        causes = tuple(Rival(c["effect"], c["joint"], {s["name"]: float(s["value"]) for s in c["size"]})
                       for c in found["causes"])
        named = {c.label for c in causes}
        others = [r for r in map(_of_candidate, found["candidates"]) if r is not None and r.label not in named]
    except (KeyError, TypeError, ValueError):
        raise InputError(where, "`causes` or `candidates` are damaged", REMEDY) from None
    distinct = tuple({r.label: r for r in reversed(others)}.values())[::-1]
    rivals, sure = (causes, ()) if verdict == "one_of" else (distinct, causes if verdict == "partial" else ())
    known = tuple(r for r in rivals if _designable(r))[:None if verdict == "one_of" else MOST]
    last = rivals.index(known[-1]) if known and verdict != "one_of" else len(rivals)
    left = tuple(_why_left_out(r) for r in rivals[:last] if not _designable(r))
    if len(known) < 2:
        raise InputError(where, "; ".join(["names fewer than two rivals that a torque plan can tell apart", *left]),
                         "plan a session by legid excite --session DIR --next DIAGNOSIS.json")
    return Question(known, tuple(c for c in sure if c.effect in known_effects()), "against" in found, left)


def _designable(rival: Rival) -> bool:
    """Whether the information of a plan has a column for it."""
    return rival.effect == "parameter" or rival.effect in known_effects()


def _why_left_out(rival: Rival) -> str:
    if rival.effect in ("payload", "links"):
        return (f"{rival.effect}{f' at link {rival.joint}' if rival.joint else ''} is left out: it changes several "
                "parameters, and the design tells apart rivals of one parameter or one effect; weigh or measure the "
                "link instead")
    return f"{rival.label} is left out: no effect of that name is installed here; install its package"


def _of_candidate(row: dict[str, Any]) -> Rival | None:
    """A runner-up with its estimated size, else the smallest that would have shown."""
    kind = known_effects().get(row["effect"])
    name = row.get("size_name") or (kind.sizes[0].name if kind else None)
    size = row.get("change", row.get("size")) or row.get("smallest_detectable")
    return None if name is None or not size else Rival(row["effect"], row["joint"], {name: float(size)})


class Contest:
    """The rivals on a bench: what a plan's motion tells about them."""

    def __init__(self, bench: Bench, question: Question, options: FitOptions, known: FloatArray | None = None,
                 reach: FloatArray | None = None, gear_ratio: float = 1.0) -> None:
        """`known` (p, p): what reference runs tell of the parameters; without it they are known exactly where rivals
        are changes, and not at all elsewhere. `reach` (n, 2): range of the angles that effects may depend on."""
        m = bench.mechanism
        self.bench, self.question = bench, question
        self._free = [] if question.against and known is None else list(range(m.p))
        self._known = np.zeros((m.p, m.p)) if known is None else known
        self._places: dict[str, list[list[int]]] = {}
        self._sizes: dict[str, FloatArray] = {}
        columns: list[Column] = []
        kinds, at = known_effects(), m.p
        for rival in (*question.rivals, *question.sure):
            if rival.effect == "parameter":
                self._places[rival.label] = [[m.names.index(rival.label)]]
                self._sizes[rival.label] = np.array([rival.sizes[rival.label]])
                continue
            kind = kinds[rival.effect]
            whole = m.actuated[0] if kind.per_joint else None  # the contract has no joint for a rotor: the driven one
            effect = placed(kind, whole if rival.joint is None else rival.joint - 1, m)
            self._sizes[rival.label] = np.array([rival.sizes.get(s.name, 0.0) for s in effect.sizes])
            for shape in dict.fromkeys((_shape(effect, rival), *effect.grid())):
                columns.append(Column(effect, shape))
                self._places.setdefault(rival.label, []).append(list(range(at, at + len(effect.sizes))))
                at += len(effect.sizes)
        model = FittedModel(m, "zero", bench.beta, noise=_noise(bench, options.sensors == "imu"), angle_range=reach,
                            gear_ratio=gear_ratio)
        fit = known_reference(model, replace(options, hold="zero", smoothing_velocity="given"))
        self._fit = replace(fit, candidates=tuple(columns), named=len(columns))

    def information(self, moved: Moved) -> FloatArray:
        """(m, m) of the parameters and the rivals' columns by one run of this motion. Raises `FitError`."""
        m = self.bench.mechanism
        columns = {angle_column(m, j): moved.q[:, j] for j in range(m.n)}
        columns |= {torque_column(m, j): moved.torque for j in m.actuated}
        if self._fit.options.sensors == "imu":
            columns |= predicted_columns(m, moved.q, moved.v, np.gradient(moved.v, 1.0 / RATE_HZ, axis=0))
        return score_run(self._fit, Dataset("plan", RATE_HZ, np.arange(len(moved.q)) / RATE_HZ, columns)).information

    def ratios(self, information: FloatArray) -> FloatArray:
        """(ordered pairs,) lambda: the first rival is true, the second is fitted at its likeliest shape."""
        return np.array([min(self.left(information, a, fitted) for fitted in self._places[b.label])
                         for a, b in permutations(self.question.rivals, 2)])

    def left(self, information: FloatArray, a: Rival, fitted: Sequence[int] = ()) -> float:
        """lambda of rival a with what parameters, sure causes and the columns `fitted` take up removed."""
        own, theta = self._places[a.label][0], self._sizes[a.label]
        taken = [*self._free, *fitted, *(k for one in self.question.sure for k in self._places[one.label][0])]
        whole = information[np.ix_(taken, taken)]
        count = len(self._free)
        whole[:count, :count] += self._known[:count, :count]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
        onto = (information[np.ix_(taken, own)] @ theta) * scale
        inverse = np.linalg.pinv(whole * np.outer(scale, scale), 1e-10, hermitian=True)
        return max(float(theta @ information[np.ix_(own, own)] @ theta - onto @ inverse @ onto), 0.0)


def contest_of(bench: Bench, question: Question, model: Model, options: FitOptions) -> Contest:
    """The rivals on `bench`, with what `model` holds of its runs."""
    held, p = model.reference, bench.mechanism.p
    known = None
    if question.against and held is not None:
        m = len(held.columns)
        whole = np.zeros((m, m))
        whole[np.triu_indices(m)] = np.frombuffer(held.information, "<f8")
        known = np.triu(whole[:p, :p]) + np.triu(whole[:p, :p], 1).T
    return Contest(bench, question, options, known, np.array(model.reach, dtype=float) if model.reach else None,
                   model.gear_ratio)


def _shape(effect: Effect, rival: Rival) -> tuple[float, ...]:
    """The rival's shapes; one that the diagnosis does not state is in the middle of its grid."""
    return tuple(rival.sizes.get(shape.name, effect.tried(shape)[len(shape.grid) // 2]) for shape in effect.shapes)


def _noise(bench: Bench, imu: bool) -> Noise:
    """The model's noise for samples at RATE_HZ."""
    level = bench.noise
    encoder = np.full(bench.mechanism.n, level["encoder_rad"])
    if not imu:
        return Noise(bench.fine.torque_level, encoder)
    encoder[0] = np.inf
    accel = [level.get(f"accel_{axis}_mps2", level["accel_mps2"]) for axis in "xy"]
    return Noise(bench.fine.torque_level, encoder, np.array([level["gyro_radps"]]), np.array([accel]))


def widening_bands(seconds: float, low_hz: float, rate_hz: float) -> tuple[Band, ...]:
    """Bands whose highest frequency doubles, from USUAL_HIGH_HZ to that of SAMPLES_A_PERIOD at the rig's `rate_hz`.

    What tells rivals apart can lie above the motion that tells most about the parameters.
    """
    most = min(rate_hz, RATE_HZ) / SAMPLES_A_PERIOD
    doublings = max(ceil(log2(most / USUAL_HIGH_HZ)), 0)
    return tuple(Band(seconds, low_hz, high) for high in
                 (*(USUAL_HIGH_HZ * 2.0**k for k in range(doublings)), max(most, USUAL_HIGH_HZ)))


def separate(contest: Contest, bands: Sequence[Band], search: Search,
             progress: Callable[[float, float], None] | None = None) -> Separation:
    """The best plan found in any of the `bands`, which are of one length.

    Draws of Fourier series of each band, every kind of waveform and the best plan for the parameters in the first band,
    then an evolution strategy from the best of each band. Raises `InputError`, and `WorkError` where no plan
    keeps the limits.
    """
    bench, rng = contest.bench, np.random.default_rng(search.seed)
    mixes = [_mix_of(band) for band in bands]
    time_s = np.arange(mixes[0].shape[1]) / RATE_HZ
    starts = [[rng.standard_normal(len(mix)) @ mix for _ in range(DRAWS * search.tries)] for mix in mixes]
    starts[-1] += [kind.shape(time_s, rng) for kind in KINDS.values() if kind.shape is not None]
    starts[0].append(design(bench, bands[0], search).best.torque_nm)
    steps = search.steps * search.tries
    total = sum(map(len, starts)) + len(mixes) * steps
    done = 0

    def judged(shape: FloatArray) -> tuple[float, FloatArray]:
        """Bound on wrong decisions (log), and the shape at the size that the limits allow."""
        nonlocal done
        done += 1
        if progress is not None:
            progress(float(done), float(total))
        moved = as_large_as_allowed(bench.fine, shape / np.abs(shape).max(), bench.limits, search.margin)
        if moved is None:
            return np.inf, shape
        try:
            return float(logsumexp(-contest.ratios(contest.information(moved)) / 8.0)), moved.torque
        except (FitError, np.linalg.LinAlgError):
            return np.inf, shape

    def climbed(worth: float, torque: FloatArray, mix: FloatArray) -> tuple[float, FloatArray]:
        """The end of an evolution strategy from a shape, by changes in its band."""
        step = STEP
        for _ in range(steps):
            change = rng.standard_normal(len(mix)) @ mix
            other = judged(torque + step * np.std(torque) / np.std(change) * change)
            better = other[0] < worth
            step *= GROW if better else SHRINK
            worth, torque = other if better else (worth, torque)
        return worth, torque

    tried = [[judged(shape) for shape in shapes] for shapes in starts]
    first = next((torque for worth, torque in itertools.chain(*tried) if np.isfinite(worth)), None)
    torque = min((climbed(*min(each, key=lambda one: one[0]), mix) for each, mix in zip(tried, mixes)),
                 key=lambda one: one[0])[1]
    if first is None:
        raise WorkError("no plan within the limits was found; widen [limits], or lower --high")
    before, after = (bench.sized(one / np.abs(one).max(), search.margin, float(np.abs(one).max()))
                     for one in (first, torque))
    if before is None or after is None:
        raise WorkError("no plan keeps the limits with the uncertainty of the parameters; widen [limits]")
    names = [r.label for r in contest.question.rivals]
    return Separation(before, after, tuple(combinations(names, 2)), expected_ratios(contest, before.torque_nm),
                      expected_ratios(contest, after.torque_nm))


def _mix_of(band: Band) -> FloatArray:
    """(2 h, N) waves of the band's series whose amplitudes fall off with the square of the frequency."""
    series = Series(band, LINES)
    return np.asarray(series.basis(RATE_HZ) / np.tile(1.0 + series.hz**2, 2)[:, None])


def expected_ratios(contest: Contest, torque_nm: FloatArray) -> FloatArray:
    """(pairs,) expected log likelihood ratio of one run under this torque, the smaller of both directions. Raises
    `WorkError` where the motion diverges."""
    moved = contest.bench.fine.move(torque_nm)
    if moved is None:
        raise WorkError("the motion of the plan diverges")
    ordered = list(permutations(range(len(contest.question.rivals)), 2))
    found = dict(zip(ordered, 0.5 * contest.ratios(contest.information(moved))))
    return np.array([min(ratio, found[j, i]) for (i, j), ratio in found.items() if i < j])


def separation_text(found: Separation, question: Question) -> str:
    """Text for a person: of each pair the seconds until it is settled, by this plan and by the first draw; then the
    rivals that are left out."""
    lines = []
    for (a, b), before, after in zip(found.pairs, found.before, found.after):
        if after < LEAST:
            lines.append(f"{a} or {b}: no torque found within the limits tells them apart")
            continue
        expected, sure = (settling_seconds(found.seconds, after, power) for power in (0.5, POWER))
        first = f"{settling_seconds(found.seconds, before, 0.5):.3g} s" if before >= LEAST else "never"
        lines.append(f"{a} or {b}: likelihood ratio {np.exp(CERTAIN):.0f} expected after {expected:.3g} s of this "
                     f"plan, with {100 * POWER:.0f} % probability after {sure:.3g} s (random phases: {first})")
    return "\n".join([*lines, *question.left_out])


def settling_seconds(seconds: float, ratio: float, power: float = POWER) -> float:
    """Motion [s] after which the log likelihood ratio exceeds CERTAIN with probability `power`, where one plan of so
    many seconds has the mean `ratio`."""
    z = float(ndtri(power))
    root = z + np.sqrt(z * z + 2.0 * CERTAIN)  # lambda / 2 - z sqrt(lambda) = CERTAIN
    return float(0.5 * root * root / ratio * seconds)
