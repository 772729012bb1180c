"""Tables of results: for a notebook as HTML, for calculations as pandas where it is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import inf
from typing import TYPE_CHECKING, Any

from daq import WorkError

if TYPE_CHECKING:
    from pandas import DataFrame



class Shown:
    """A result whose `repr` is its name and the first line of what it prints."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: what `print` does."""
        return f"<pre>{escape(str(self))}</pre>"

    def check(self) -> None:
        """Raises `WorkError` for a result that is no use, such as a fit that did not converge."""


class Judged(Shown):
    """A result with a verdict and its sentence, which can be that no answer is possible."""

    verdict: Any
    sentence: Any

    @property
    def failed(self) -> bool:
        """Whether no answer is possible; `sentence` says why."""
        return bool(self.verdict == "fit_failed")

    def check(self) -> None:
        """Raises `WorkError` for one that failed."""
        if self.failed:
            raise WorkError(self.sentence)


def kept_with(document: object, name: str, lack: str) -> Any:
    """Input from which a verb made `document`. Raises `WorkError` for a document of a file, which lacks that."""
    try:
        return vars(document)["made"]
    except KeyError:
        raise WorkError(f"this {name} was read from a file, which has no {lack}") from None


def frame(columns: Mapping[str, Any], index: str | None = None) -> DataFrame:
    """`columns` as a DataFrame, one of them as its index. Raises `WorkError` where pandas is not installed."""
    try:
        from pandas import DataFrame
    except ImportError:
        raise WorkError('to_frame() needs the package pandas; install it: pip install "legid[notebook]"') from None
    table = DataFrame(dict(columns))
    return table if index is None else table.set_index(index)


def frame_of(rows: Sequence[Mapping[str, Any]], index: str) -> DataFrame:
    """`rows`, which have the same keys, as a DataFrame. Raises `WorkError` where pandas is not installed."""
    return frame({name: [row[name] for row in rows] for name in (rows[0] if rows else (index,))}, index)


def columns(rows: Sequence[Any], keys: str) -> dict[str, list[Any]]:
    """Values of each of `keys`, with spaces between them, in `rows`: structs of a document, or tuples of such.

    `a.b` is the key b of the struct below a, or of the struct at the place a of a tuple; None where there is none.
    `name=key` calls it otherwise, an interval gives the columns `low` and `high`.
    """
    found: dict[str, list[Any]] = {}
    for key in keys.split():
        name, _, path = key.rpartition("=")
        values = [_value(row, path) for row in rows]
        if path.endswith("ci95"):
            ends = [(None, None) if pair is None else pair for pair in values]
            found |= {"low": [low for low, _ in ends], "high": [high for _, high in ends]}
        else:
            found[name or path.rpartition(".")[2]] = values
    return found


def _value(row: Any, path: str) -> Any:
    for part in path.split("."):
        row = None if row is None else row[int(part)] if part.isdecimal() else getattr(row, part)
    return row


def or_inf(values: Sequence[float | None]) -> list[float]:
    """The numbers, infinity for null: an error that diverged, a change that no run can show."""
    return [inf if value is None else value for value in values]
