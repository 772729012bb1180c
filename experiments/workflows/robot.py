"""`judge_robot`: a robot file put to runs: its free-run error, and which of its parameters the runs contradict."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq import Rig
from experiments.console import text_table
from experiments.documents import ValidationDocument
from experiments.judge import model_of
from experiments.models import fitted_settings
from experiments.reports import validation_text
from experiments.session import Runs, prepare
from experiments.simulators import model_of_robot, read_robot
from experiments.workflows.fit import fit_runs
from experiments.workflows.validate import ValidationReport, validate_prepared

HEADER = ["parameter", "file", "runs", "95 % interval", "off by", "unit", "meaning"]


@dataclass(frozen=True)
class Contradiction:
    """One parameter of the file and of the runs."""

    name: str
    meaning: str
    unit: str
    file: float
    runs: float
    half_width: float
    """Of the 95 % interval by the runs."""

    @property
    def half_widths(self) -> float:
        """The file's value less that of the runs, in half widths."""
        return (self.file - self.runs) / self.half_width if self.half_width > 0.0 else np.nan

    @property
    def contradicted(self) -> bool:
        """Whether the interval leaves the file's value out."""
        return abs(self.half_widths) > 1.0

    @property
    def cells(self) -> list[str]:
        """Row of the table under `HEADER`."""
        off = f"{self.half_widths:+.1f} half widths" if self.contradicted else ""
        return [self.name, f"{self.file:.4g}", f"{self.runs:.4g}",
                f"{self.runs - self.half_width:.4g} .. {self.runs + self.half_width:.4g}", off, self.unit, self.meaning]


@dataclass(frozen=True)
class RobotReport:
    """A robot file against runs."""

    rows: tuple[Contradiction, ...]
    validation: ValidationReport
    fitted: ValidationReport
    """The model fitted to the same runs: what is possible."""

    def text(self) -> str:
        """The report for a terminal."""
        cells = [r.cells for r in self.rows]
        wrong = [r.name for r in self.rows if r.contradicted]
        table, best = self.validation.table, self.fitted.table
        errors = [f"  {c}: {table.rms(0, c, np.inf):.4g} rms; by the model fitted to these runs "
                  f"{best.rms(0, c, np.inf):.4g}" for c in table.judged]
        told = f"The runs contradict {len(wrong)} of {len(self.rows)} parameters: {', '.join(wrong)}." if wrong else \
            f"The runs contradict none of {len(self.rows)} parameters."
        return "\n".join([told, "", text_table(HEADER, cells, right={1, 2, 3, 4}), "", "Free runs of the file's model:",
                          *errors, "", validation_text(self.validation.as_document(ValidationDocument))])


def judge_robot(path: Path, runs: Runs, rig: Rig) -> RobotReport:
    """The chain of a URDF or MJCF file against runs of its rig. Raises `InputError`, `FitError`."""
    links = read_robot(path)
    found = fit_runs(runs, rig)
    result = found.result
    settings = fitted_settings(found.setup.settings, result.mechanism)
    model = model_of_robot(links, settings, result.hold, str(path))
    prepared = prepare(runs, found.rig, model=model)
    rows = tuple(Contradiction(p.name, p.meaning, p.unit, a, float(b), float(half)) for p, a, b, half in
                 zip(result.mechanism.parameters, model.beta, result.beta, result.half_width))
    own = model_of(result, found.setup.settings, found.setup.options.hold, [d.name for d in found.setup.datasets])
    return RobotReport(rows, validate_prepared(model, prepared, str(path)), validate_prepared(own, prepared, "the fit"))


