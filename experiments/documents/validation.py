"""`legid.validation/1`: errors of a model's free runs, as `legid validate --json` writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from estimator.prediction import SHORT_S, PredictionTable, Validation, WalkAhead, validations_of
from experiments.documents.document import Aside, Damaged, Document, From, Number
from experiments.documents.walk import Walk
from experiments.judge import Headline, Trust, fits_of
from experiments.session import Prepared, damaged_runs, faulty_readings

ByColumn = dict[str, Number]


class RunFit(Struct, frozen=True, kw_only=True):
    """Fit of the free runs of one run."""

    run: Annotated[str, Meta(description="the run")]
    whole: Annotated[ByColumn, Meta(description="fit of the whole run [%] by sensor; null if diverged")]
    short: Annotated[ByColumn, Meta(description="fit of pieces of `short_s`")]
    short_s: Annotated[float, Meta(description="their length [s]")]


class Segment(Struct, frozen=True, kw_only=True):
    """One gap-free segment of a run, simulated as a whole."""

    run: Annotated[str, Meta(description="the run")]
    samples: Annotated[int, Meta(description="in the segment")]
    horizon_s: Annotated[float, Meta(description="how long the free run stayed within bounds")]
    diverged: Annotated[bool, Meta(description="whether it left them")]
    initial_state: Annotated[ByColumn, Meta(description="where it starts, by signal")]
    summed_squared_error: Annotated[ByColumn, Meta(description="by signal; null if diverged")]
    rmse: Annotated[ByColumn, Meta(description="rms error by signal; null if diverged at once")]
    start_s: Annotated[Number, Meta(description="start in the run's own time [s]")] = None


class Other(Struct, frozen=True, kw_only=True):
    """Errors of another model."""

    rmse: Annotated[ByColumn, Meta(description="of the other model")]
    blown_up: Annotated[int, Meta(description="of the other model")]


class Horizon(Struct, frozen=True, kw_only=True):
    """Errors of free runs over pieces of one length."""

    horizon_s: Annotated[float, Meta(description="length [s]; the last entry is whole segments")]
    pieces: Annotated[int, Meta(description="free runs")]
    blown_up: Annotated[int, Meta(description="those that diverged; they stay in their initial state")]
    rmse: Annotated[ByColumn, Meta(description="rms error by angle")]
    last_velocity: Annotated[ByColumn, Meta(description="that of the last velocity kept")]
    noise: Annotated[ByColumn, Meta(description="rms of the readings about the smoothed motion")]
    against: Annotated[Other | UnsetType, Meta(description="with `--against`")] = UNSET


class ValidationDocument(Document, kw_only=True):
    """Free runs of a model against runs that it was not fitted to."""

    schema: Annotated[Literal["legid.validation/1"], Meta(description="of this document")] = "legid.validation/1"
    sensors: Annotated[str, Meta(description="imu or encoder: source of the pivot's angle")]
    fit_percent: Annotated[tuple[RunFit, ...], Meta(description="one entry a run")]
    runs: Annotated[tuple[Segment, ...], Meta(description="one entry a gap-free segment")]
    trust: Annotated[Trust, Meta(description="the first line")] = Trust("caution", "")
    fitted_to: Annotated[tuple[str, ...], Meta(description="files of these that the model was fitted to")] = ()
    horizons: Annotated[tuple[Horizon, ...], Meta(description="one entry a length")] = ()
    set_aside: Aside = ()
    readings: Annotated[tuple[dict[str, object], ...], Meta(description="as in a fit")] = ()
    walk: Annotated[Walk | UnsetType, Meta(description="of a walker, across touchdowns")] = UNSET
    simulator: Annotated[str | UnsetType, Meta(description="absent: legid's")] = UNSET
    damaged: Damaged = ()
    provenance: From = UNSET

    @property
    def headline(self) -> Headline:
        """First lines: the trust in it."""
        return self.trust.headline

    @classmethod
    def of(cls, table: PredictionTable, trust: Trust, prepared: Prepared, seen: Sequence[str] = (),
           steps: WalkAhead | None = None) -> Self:
        """The document of free runs on the runs of `prepared`; `seen` are those that the model was fitted to."""
        used = prepared.setup.datasets
        return cls(sensors=prepared.setup.options.sensors, fit_percent=run_fits(table),
                   runs=tuple(map(segment_of, validations_of(table))), trust=trust, fitted_to=tuple(seen),
                   horizons=horizons_of(table), set_aside=prepared.set_aside, readings=tuple(faulty_readings(used)),
                   walk=UNSET if steps is None else Walk.of(steps), damaged=tuple(damaged_runs(used)))


def run_fits(table: PredictionTable) -> tuple[RunFit, ...]:
    """One entry a run."""
    return tuple(RunFit(run=one.run, whole={**fits_of(table, k, np.inf)}, short={**fits_of(table, k, SHORT_S)},
                        short_s=SHORT_S) for k, one in enumerate(table.runs))


def segment_of(v: Validation) -> Segment:
    """The entry of one whole free run."""
    def floats(values: Mapping[str, float]) -> ByColumn:
        return {name: float(value) for name, value in values.items()}

    state = [float(x) for pair in zip(v.q[0], v.qd[0]) for x in pair]
    return Segment(run=v.run, samples=int(v.time_s.shape[0]), horizon_s=float(v.horizon_s), diverged=bool(v.diverged),
                   initial_state=dict(zip(v.sums, state, strict=True)), summed_squared_error=floats(v.sums),
                   rmse=floats(v.rmse), start_s=float(v.time_s[0]))


def horizons_of(table: PredictionTable) -> tuple[Horizon, ...]:
    """One entry a horizon; whole segments are as long as the longest of them."""
    longest = max(run.longest_s for run in table.runs)

    def by_joint(value: Callable[[str], float]) -> ByColumn:
        return {column: float(value(column)) for column in table.angles}

    def entry(k: int, h: float) -> Horizon:
        lost = [int(x) for x in table.lost[:, k]]
        return Horizon(
            horizon_s=float(longest if np.isinf(h) else h), pieces=int(table.pieces[k]), blown_up=lost[0],
            rmse=by_joint(lambda c: table.rms(0, c, h)), last_velocity=by_joint(lambda c: table.rms_kept(c, h)),
            noise=by_joint(table.rms_residual),
            against=UNSET if len(lost) < 2 else Other(rmse=by_joint(lambda c: table.rms(1, c, h)), blown_up=lost[1]))

    return tuple(entry(k, h) for k, h in enumerate(table.horizons_s))
