"""Results of the functions of `legid.tools` and `legid.tune`: tables that show themselves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq import Column, write_file
from daq import Dataset as PlainDataset
from daq.recording import Plan
from experiments.exchange import Guess as PlainGuess
from experiments.exchange import guess_text
from experiments.excite import Design, design_text
from experiments.judge import Comparison as PlainComparison
from experiments.judge import comparison_trust
from experiments.models import Gains as PlainGains
from experiments.models import Tolerances, effects_document, effects_text, gain_rows, gains_document, gains_text
from experiments.reports import (
    GUESS_HEADER,
    Source,
    comparison_document,
    comparison_text,
    guess_rows,
    guess_section,
    guess_table,
    guess_verdict,
    origin_from,
    write_comparison,
    write_document,
    write_page,
)
from experiments.session import damaged_runs
from experiments.workflows import Tuning as PlainTuning
from experiments.workflows import tuning_document, tuning_rows, tuning_text
from legid.tables import Shown, frame, html_table, paragraphs

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from daq import Rig


@dataclass(frozen=True, repr=False)
class Gains(Shown):
    """Feedforward and PD gains of a model, with their margins."""

    found: PlainGains
    tolerated: Tolerances

    @property
    def document(self) -> dict[str, Any]:
        """`legid.gains/1`, as `legid gains --json` writes it."""
        return gains_document(self.found, self.tolerated)

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document)

    def to_frame(self) -> DataFrame:
        """One row a gain or margin: value, unit, meaning. Raises `WorkError` without pandas."""
        rows = gain_rows(self.found)
        values = list(self.found)[1:]
        return frame({"gain": [row[0] for row in rows], "value": values, "unit": [row[2] for row in rows],
                      "meaning": [row[3] for row in rows]}, "gain")

    def __str__(self) -> str:
        return gains_text(self.found)

    def _repr_html_(self) -> str:
        return html_table(["gain", "value", "unit", "meaning"], gain_rows(self.found))


@dataclass(frozen=True, repr=False)
class Guess(Shown):
    """The columns of another program's file as `legid import --guess` guesses them."""

    found: PlainGuess
    file: str

    @property
    def columns(self) -> dict[str, Column]:
        """The map, which `read` takes."""
        return self.found.columns

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Columns that no unit and sign makes fit, in words; with any, correct the map before you use it."""
        return tuple(self.found.unexplained)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Points to be looked at before the guess is used."""
        return tuple(self.found.warnings)

    def write(self, path: Path | str) -> None:
        """Write the map as COLUMNS.toml. Raises `InputError` where that place cannot be written."""
        write_file(Path(path), guess_text(self.found.columns, self.found.notes).encode(), changed=True)

    def page(self, path: Path | str) -> None:
        """Write the page by which to judge it. Raises `InputError`."""
        write_page(path, f"Columns of {self.file}", "A guess: look at it before it is used.",
                   [guess_section(self.found, self.file)], verdict=guess_verdict(self.found))

    def to_frame(self) -> DataFrame:
        """One row a column: the file's column, unit, sign, reason. Raises `WorkError` without pandas."""
        rows = guess_rows(self.found)
        return frame({name: [row[k] for row in rows] for k, name in enumerate(GUESS_HEADER)}, GUESS_HEADER[0])

    def __str__(self) -> str:
        return f"{guess_verdict(self.found).title}\n\n{guess_table(self.found)}"

    def _repr_html_(self) -> str:
        notes = [f"Warning: {text}" for text in (*self.found.unexplained, *self.found.warnings)]
        return html_table(GUESS_HEADER, guess_rows(self.found)) + paragraphs(notes)


@dataclass(frozen=True, repr=False)
class Effects(Shown):
    """The library of effects that a diagnosis can name."""

    @property
    def document(self) -> dict[str, Any]:
        """`legid.effects/1`, as `legid effects --json` writes it."""
        return effects_document()

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document)

    def to_frame(self) -> DataFrame:
        """One row an effect: meaning, sizes with units, whether by joint, what shows it best.

        Raises `WorkError` without pandas.
        """
        rows = self.document["effects"]
        return frame({"effect": [row["effect"] for row in rows], "meaning": [row["meaning"] for row in rows],
                      "sizes": [", ".join(f"{s['name']} [{s['unit']}]" for s in row["sizes"]) for row in rows],
                      "by_joint": [row["by_joint"] for row in rows],
                      "experiment": [row["experiment"] for row in rows]}, "effect")

    def __str__(self) -> str:
        return effects_text()

    def _repr_html_(self) -> str:
        rows = [[row["effect"], row["meaning"], row["experiment"]] for row in self.document["effects"]]
        return html_table(["effect", "meaning", "best shown by"], rows)


@dataclass(frozen=True, repr=False)
class Excitation(Shown):
    """A torque plan, and what it is predicted to tell where a prior model designed it."""

    plan: Plan
    """Torque [N m] over time [s]."""
    design: Design | None = None
    """The plan next to its first draw; None without a prior model."""
    rig: Rig | None = None

    def to_frame(self) -> DataFrame:
        """One row a parameter: its value and predicted standard error, of the first draw and of the plan.

        Without a prior model: one row a sample, torque [N m] by time [s]. Raises `WorkError` without pandas.
        """
        if self.design is None:
            return frame({"time_s": self.plan.time_s, "torque_nm": self.plan.torque_nm}, "time_s")
        d = self.design
        return frame({"parameter": list(d.names), "value": d.beta, "std_first": d.first.std, "std": d.best.std},
                     "parameter")

    def plot(self) -> Figure:
        """The torque over time."""
        from legid.figures import plan_figure

        return plan_figure(self.plan)

    def __str__(self) -> str:
        if self.design is not None and self.rig is not None:
            return design_text(self.design, self.rig.limits)
        return f"{self.plan.duration_s:.1f} s at most {self.plan.peak_nm:.3g} N m"

    def _repr_html_(self) -> str:
        return paragraphs(str(self).splitlines())


@dataclass(frozen=True, repr=False)
class Tuning(Shown):
    """Entries of a rig file that predict its records best, and what else was tried."""

    found: PlainTuning
    sources: tuple[Source, ...] = ()
    """The run files."""

    @property
    def document(self) -> dict[str, Any]:
        """`legid.tuning/1`, as `legid tune --json` writes it."""
        return {**tuning_document(self.found), "damaged": []}

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, self.sources)

    def to_frame(self, what: str = "chosen") -> DataFrame:
        """`chosen`: one row an entry with its value, reason and effect; `tried`: one row a value that was tried.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "tried":
            return frame({name: [row[k] for row in self.found.tried]
                          for k, name in enumerate(("entry", "value", "error"))})
        if what != "chosen":
            raise ValueError(f"{what!r} is neither 'chosen' nor 'tried'")
        return frame({name: [row[k] for row in tuning_rows(self.found)]
                      for k, name in enumerate(("entry", "chosen", "why", "changes"))})

    def plot(self) -> Figure:
        """The error of runs not fitted, by joint, before and after. Raises `WorkError` where no trial converged."""
        from legid.figures import tuning_figure

        return tuning_figure(self.found)

    def __str__(self) -> str:
        return tuning_text(self.found)

    def _repr_html_(self) -> str:
        flags = [f"Warning: {text}" for text in (*map(str, self.found.aside), *self.found.flags)]
        rows = tuning_rows(self.found)
        head = html_table(["entry", "chosen", "why", "what it changes"], rows) if rows else paragraphs(
            ["no change: rig.toml predicts best as it is"])
        return head + paragraphs(flags)


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Two models on the same runs: parameters, free-run errors over horizons, and which one is better."""

    found: PlainComparison
    runs: tuple[PlainDataset, ...] = ()
    """What was given."""
    sources: tuple[Source, ...] = ()
    """The run files."""
    mechanism: str = ""
    """Name of the models' mechanism."""

    @property
    def document(self) -> dict[str, Any]:
        """`legid.comparison/1`, as `legid compare --json` writes it."""
        used = [run for run in self.runs if run.name in self.found.runs]
        return {**comparison_document(self.found), "damaged": damaged_runs(used)}

    def to_json(self, path: Path | str) -> None:
        """Write `document` with its provenance. Raises `InputError`."""
        write_document(path, self.document, self.sources)

    def page(self, path: Path | str) -> None:
        """Write the page of `legid compare --html`. Raises `InputError`."""
        write_comparison(path, self.found, self.mechanism, self.runs, origin_from(self.sources))

    @property
    def trust(self) -> str:
        """The better model, and where: the first line of `legid compare`."""
        return comparison_trust(self.found).sentence

    def to_frame(self, what: str = "errors") -> DataFrame:
        """`errors`: one row a horizon and sensor, rms errors and their ratio; `parameters`: one row a parameter.

        A horizon of infinity is a whole segment. Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "parameters":
            rows = self.found.parameters
            values = {name: [np.nan if one is None else one.value for one in some]
                      for name, some in (("a", [p.a for p in rows]), ("b", [p.b for p in rows]))}
            return frame({"parameter": [p.name for p in rows], **values, "z": [p.z for p in rows],
                          "unit": [p.unit for p in rows], "meaning": [p.meaning for p in rows]}, "parameter")
        if what != "errors":
            raise ValueError(f"{what!r} is neither 'errors' nor 'parameters'")
        errors = self.found.errors
        intervals = [(np.nan, np.nan) if e.ci95 is None else e.ci95 for e in errors]
        return frame({"horizon_s": [e.horizon_s for e in errors], "column": [e.column for e in errors],
                      "a": [e.a for e in errors], "b": [e.b for e in errors],
                      "ratio": [e.b / e.a if np.isfinite(e.a + e.b) and e.a > 0.0 else np.nan for e in errors],
                      "low": [low for low, _ in intervals], "high": [high for _, high in intervals],
                      "better": [e.better for e in errors]})

    def plot(self) -> Figure:
        """The error of B over that of A at every horizon and sensor, with its 95 % interval."""
        from legid.figures import comparison_figure

        return comparison_figure(self.found)

    def __str__(self) -> str:
        return comparison_text(self.found)

    def _repr_html_(self) -> str:
        rows = [[f"{e.horizon_s:g} s", e.column, f"{e.a:.3g}", f"{e.b:.3g}", e.better] for e in self.found.errors]
        return paragraphs([self.trust]) + html_table(["horizon", "sensor", "rms error of A", "of B", "better"], rows)
