"""`legid.diagnosis/1`: what a simulation gets wrong and why, as `legid diagnose --json` writes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from msgspec import UNSET, Meta, Struct, field

from daq import Dataset
from estimator import Verdict
from estimator.diagnosis import MATERIAL, Diagnosis, SensorGain
from experiments.documents.diagnosis_parts import (
    Before,
    GainOnHeldOut,
    Learnt,
    Named,
    NamedCause,
    Place,
    Residual,
    Scored,
    Share,
    cause_of,
    contract_joint,
    gain_of,
    gains_of,
    learnt_of,
    scores_of,
    split_key,
    untestable,
)
from experiments.documents.document import Aside, Damaged, Document, From, Number, Uses, known
from experiments.judge import (
    VERDICTS,
    Headline,
    answer_words,
    next_step,
    normal,
    sentence_of,
    uses_line,
    verdict_title,
)
from experiments.session import SetAside, damaged_runs, faulty_readings

Intervals = dict[str, tuple[Number, Number]]
"""Parameter to both ends."""


class Rotated(Struct, frozen=True, kw_only=True):
    """One rotation of the split."""

    confirm_runs: Annotated[tuple[str, ...], Meta(description="held out")]
    sizes: Annotated[dict[str, Number], Meta(description="fitted to the others, by `effect@joint.size`")]
    falls: Annotated[bool, Meta(description="whether the error falls by `material`")]


class Explanation(Struct, frozen=True, kw_only=True):
    """One explanation that was compared."""

    causes: Annotated[tuple[Named, ...], Meta(description="its effects")]
    error: Annotated[Number, Meta(description="on the held-out runs, as `error`")]


class Parameters(Struct, frozen=True, kw_only=True):
    """Values of both models."""

    nominal: Annotated[dict[str, Number], Meta(description="by parameter")] = field(default_factory=dict)
    extended: Annotated[dict[str, Number], Meta(description="by parameter; empty without a cause")] = field(
        default_factory=dict)
    nominal_std: Annotated[dict[str, Number], Meta(description="standard deviations of `nominal`")] = field(
        default_factory=dict)
    extended_std: Annotated[dict[str, Number], Meta(description="standard deviations of `extended`")] = field(
        default_factory=dict)
    nominal_ci95: Annotated[Intervals, Meta(description="95 % intervals of `nominal`")] = field(default_factory=dict)
    extended_ci95: Annotated[Intervals, Meta(description="95 % intervals of `extended`")] = field(default_factory=dict)

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Self:
        """Values of a diagnosis, and what is known of them."""
        own: dict[str, dict[str, Any]] = {}
        for model, values, std in (("nominal", diagnosis.nominal, diagnosis.nominal_std),
                                   ("extended", diagnosis.extended, diagnosis.extended_std)):
            every = {name: normal(value, std[name]) for name, value in values.items() if name in std}
            own |= {model: dict(values), f"{model}_std": {name: known(one.std) for name, one in every.items()},
                    f"{model}_ci95": {name: (known(one.low), known(one.high)) for name, one in every.items()}}
        return cls(**own)


class NotTestable(Struct, frozen=True, kw_only=True):
    """One effect that these runs cannot test."""

    effect: Annotated[str, Meta(description="of the library")]
    joint: Place
    why: Annotated[str, Meta(description="the reason")]


class Groups(Struct, frozen=True, kw_only=True):
    """Use of the runs."""

    fit: Annotated[tuple[str, ...], Meta(description="train runs")] = ()
    screen: Annotated[tuple[str, ...], Meta(description="empty")] = ()
    confirm: Annotated[tuple[str, ...], Meta(description="test runs")] = ()


class DiagnosisDocument(Document, kw_only=True):
    """Errors of a simulation, their causes, and the gain of extending the model."""

    schema: Annotated[Literal["legid.diagnosis/1"], Meta(description="of this document")] = "legid.diagnosis/1"
    verdict: Annotated[Verdict, Meta(
        description="none, named, partial, one_of, unexplained, or fit_failed: no diagnosis is possible")]
    sentence: Annotated[str, Meta(description="the verdict for people")] = ""
    causes: Annotated[tuple[NamedCause, ...], Meta(description="named, or possible")] = ()
    candidates: Annotated[tuple[Scored, ...], Meta(description="every effect of the library")] = ()
    gain: Annotated[GainOnHeldOut, Meta(description="errors on held-out runs")]
    material: Annotated[float, Meta(description="smallest relative reduction of the rms error that counts")] = MATERIAL
    budget: Annotated[tuple[Share, ...], Meta(description="parts of the error")] = ()
    immaterial: Annotated[tuple[NamedCause, ...], Meta(
        description="present causes that lower the error by less than `material`")] = ()
    remainder: Annotated[Residual | None, Meta(description="place of the residual")] = None
    structure: Annotated[Learnt | None, Meta(description="of the residual, or null")] = None
    probability: Annotated[Number, Meta(description="that the answer is true, [as on simulated legs]"
                                        "(docs/evidence/causes.md); null if `unexplained`")] = None
    probability_in_library: Annotated[Number, Meta(description="the same if the library has the causes")] = None
    stability: Annotated[Number, Meta(description="share of the rotations in which the error falls")] = None
    rotations: Annotated[tuple[Rotated, ...], Meta(
        description="if rotated: `budget` and `error` are then of all runs")] = ()
    error: Annotated[Before | None, Meta(description="rms error in units of noise alone")] = None
    compared: Annotated[tuple[Explanation, ...], Meta(description="explanations, the least error first")] = ()
    parameters: Annotated[Parameters, Meta(description="of both models")] = Parameters()
    uses: Uses = ()
    not_testable: Annotated[tuple[NotTestable, ...], Meta(description="effects that these runs cannot test")] = ()
    runs: Annotated[Groups, Meta(description="their use")] = Groups()
    warnings: Annotated[tuple[str, ...], Meta(description="for people")] = ()
    next_experiment: Annotated[str, Meta(description="to tell more")] = ""
    next_step: Annotated[str, Meta(description="place, action and command")] = ""
    wall_s: Annotated[float, Meta(description="time that the diagnosis took [s]")] = 0.0
    set_aside: Aside = ()
    readings: Annotated[tuple[dict[str, object], ...], Meta(description="as in a fit")] = ()
    model: Annotated[str, Meta(description="the mechanism's model")] = ""
    force_unit: Annotated[str, Meta(description="as in a fit")] = "N m"
    hold: Annotated[str, Meta(description="of torque between samples; empty if nothing was fitted")] = ""
    damaged: Damaged = ()
    provenance: From = UNSET

    @classmethod
    def of(cls, found: Diagnosis, set_aside: Sequence[SetAside] = (), used: Sequence[Dataset] = (), model: str = ""
           ) -> Self:
        """The document of a diagnosis of the runs `used` by a mechanism called `model`."""
        return cls(
            model=model, hold=found.hold, force_unit="N m" if found.mechanism is None else found.mechanism.force_unit,
            verdict=found.verdict, sentence=found.sentence, causes=tuple(map(cause_of, found.causes)),
            candidates=scores_of(found.candidates), gain=gain_of(found), material=found.material,
            budget=tuple(Share(what=row.what, effect=row.effect,
                               joint=None if row.effect is None else contract_joint(row.effect, row.joint),
                               share=known(row.share), ci95=row.ci95, of_error=known(row.of_error),
                               of_error_ci95=row.of_error_ci95) for row in found.budget),
            immaterial=tuple(map(cause_of, found.immaterial)),
            remainder=None if found.remainder is None else Residual(
                joint=found.remainder.joint, channel=found.remainder.channel, depends_on=found.remainder.depends_on),
            structure=learnt_of(found.structure), probability=found.probability,
            probability_in_library=found.in_library, stability=found.stability,
            rotations=tuple(Rotated(confirm_runs=r.runs, sizes=dict(r.sizes), falls=r.falls) for r in found.rotations),
            error=None if found.error is None else Before(before=known(found.error[0]), after=known(found.error[1])),
            compared=tuple(Explanation(causes=tuple(
                Named(effect=effect, joint=contract_joint(effect, joint)) for effect, joint in map(split_key, keys)),
                error=known(error)) for keys, error in found.compared),
            parameters=Parameters.of(found), uses=found.uses,
            not_testable=tuple(NotTestable(effect=effect, joint=contract_joint(effect, joint), why=why)
                               for effect, joint, why in untestable(found)),
            runs=Groups(**{group: tuple(found.runs.get(group, ())) for group in ("fit", "screen", "confirm")}),
            warnings=found.warnings, next_experiment=found.next_experiment, next_step=next_step(found),
            wall_s=found.wall_s, set_aside=tuple(set_aside), readings=tuple(faulty_readings(used)),
            damaged=tuple(damaged_runs(used)))

    @property
    def _used(self) -> list[str]:
        said, model = uses_line(self.uses), "extended" if self.parameters.extended else "nominal"
        return [sentence_of(f"the {model} model {said}")] if said else []

    @property
    def headline(self) -> Headline:
        """First lines: the verdict, its sentence, uses and its probability."""
        return Headline(VERDICTS[self.verdict][0], verdict_title(self.verdict),
                        [*([self.sentence] if self.sentence else []),
                         *self._used, *answer_words(self.probability, self.probability_in_library)], self.warnings,
                        self.next_step)

    @property
    def sensors(self) -> dict[str, SensorGain]:
        """Free-run errors on the held-out runs by sensor; infinite where the nominal simulation diverges."""
        return gains_of(self.gain.free_run_rmse)

    @property
    def confirm_runs(self) -> tuple[str, ...]:
        """Names of the held-out runs."""
        return self.gain.confirm_runs

    @property
    def gap_closed(self) -> Number:
        """Share of the gap to noise alone that the extension closes, of mean squares; None where there is none."""
        return self.gain.gap_closed
