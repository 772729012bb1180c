"""Results of the functions of `legid.tools` and `legid.tune`: tables that show themselves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq import Column, write_file
from daq.recording import Plan
from experiments.console import write_json
from experiments.documents import TuningDocument
from experiments.exchange import Guess as PlainGuess
from experiments.exchange import guess_text
from experiments.excite import Design, design_text
from experiments.models import effects_document, effects_text
from experiments.provenance import Origin
from experiments.reports import (
    guess_section,
    guess_table,
    guess_verdict,
    tuning_rows,
    tuning_text,
    write_page,
)
from legid.tables import Shown, columns, frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from daq import Rig
    from experiments.reports import Table


class Listing(Shown, ABC):
    """A result whose JSON is made when it is asked for."""

    provenance: Origin | None = None

    @property
    @abstractmethod
    def document(self) -> dict[str, Any]:
        """The JSON as a dictionary, without its provenance."""

    def to_json(self, path: Path | str) -> None:
        """Write the JSON as the command's --json does. Raises `InputError`."""
        made = self.document
        write_json(path, made if self.provenance is None else {**made, "provenance": self.provenance})


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

    @property
    def table(self) -> Table:
        """One row a column."""
        return guess_table(self.found)

    def write(self, path: Path | str) -> None:
        """Write the map as COLUMNS.toml. Raises `InputError` where that place cannot be written."""
        write_file(Path(path), guess_text(self.found.columns, self.found.notes).encode(), changed=True)

    def page(self, path: Path | str) -> None:
        """Write the page by which to judge it. Raises `InputError`."""
        write_page(path, f"Columns of {Path(self.file).name}", "A guess: look at it before it is used.",
                   [guess_section(self.found, self.file)], verdict=guess_verdict(self.found))

    def to_frame(self) -> DataFrame:
        """One row a column: the file's column, unit, sign, reason. Raises `WorkError` without pandas."""
        return frame(dict(zip(self.table.header, zip(*self.table.rows))), self.table.header[0])

    def __str__(self) -> str:
        return "\n".join([*guess_verdict(self.found).told, "", self.table.text])


@dataclass(frozen=True, repr=False)
class Effects(Listing):
    """The library of effects that a diagnosis can name."""

    provenance: Origin | None = None

    @property
    def document(self) -> dict[str, Any]:
        """`legid.effects/1`, as `legid effects --json` writes it."""
        return effects_document()

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


class Tuning(Shown, TuningDocument, kw_only=True):
    """Entries of a rig file that predict its records best: `legid.tuning/1`, whose keys are its fields.

    `Tuning.read(path)` gives one of a file.
    """

    def to_frame(self, what: str = "chosen") -> DataFrame:
        """`chosen`: one row an entry with its value, reason and effect; `tried`: one row a value that was tried.

        Raises `ValueError` for any other `what`, `WorkError` without pandas.
        """
        if what == "tried":
            return frame(columns(self.tried, "entry value error"))
        if what != "chosen":
            raise ValueError(f"{what!r} is neither 'chosen' nor 'tried'")
        return frame({name: [row[k] for row in tuning_rows(self)]
                      for k, name in enumerate(("entry", "chosen", "why", "changes"))})

    def plot(self) -> Figure:
        """The error of runs not fitted, by joint, before and after. Raises `WorkError` where no trial converged."""
        from legid.figures import tuning_figure

        return tuning_figure(self)

    def __str__(self) -> str:
        return tuning_text(self)
