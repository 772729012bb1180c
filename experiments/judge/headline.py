"""`Headline`: what every result says first, in a text, on a page, in a notebook and in Python."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from estimator import Verdict

Level = Literal["good", "caution", "bad"]
"""How far an answer can be relied on."""
VERDICTS: dict[Verdict, tuple[Level, str]] = {
    "none": ("good", "nothing beyond noise"), "named": ("good", "cause named"),
    "partial": ("caution", "cause named, something is left"), "one_of": ("caution", "one of several causes"),
    "unexplained": ("caution", "something is wrong, cause unknown"), "fit_failed": ("bad", "not possible")}
"""Verdict of a diagnosis -> level of the answer, not of the leg, and its words."""
CHANGES: dict[str, tuple[Level, str]] = {
    "no_change": ("good", "No difference"), "named": ("caution", "Different: the cause is named"),
    "partial": ("caution", "Different: part of the cause is named"),
    "one_of": ("caution", "Different, by one of several causes"),
    "changed_unexplained": ("bad", "Different, and no listed cause explains it"),
    "fit_failed": ("bad", "No comparison is possible")}
"""Verdict of a change, the gravest last."""


FIGURE = re.compile(r"(?<![\w.])\d[\d.e+-]*")
"""A number that may differ between runs, and no part of a name."""


@dataclass(frozen=True)
class Headline:
    """The answer, what limits it, and the next step."""

    level: Level
    title: str
    lines: Sequence[str] = ()
    """The answer in sentences."""
    warnings: Sequence[str] = ()
    action: str = ""
    """The next step; empty without one."""

    @property
    def reasons(self) -> list[str]:
        """Lines below the title: the answer, then the warnings."""
        return [*self.lines, *(f"Warning: {text}" for text in counted(self.warnings))]

    @property
    def told(self) -> list[str]:
        """All of it, one line each."""
        return [self.title, *self.reasons, *([f"Next step: {self.action}"] if self.action else [])]

    @property
    def text(self) -> str:
        """The same for a terminal; without a title that the first line says in full."""
        return "\n".join(self.told[bool(self.lines and not self.title.endswith(".")):])


def counted(warnings: Iterable[str]) -> list[str]:
    """The warnings; those that differ in their first word, the run, and in figures alone stand once, the runs
    counted."""
    alike = dict[str, list[str]]()
    for text in dict.fromkeys(warnings):
        alike.setdefault(FIGURE.sub("", text.partition(" ")[2]), []).append(text)
    return [first + (f". Likewise in {len(more)} more: {', '.join(dict.fromkeys(text.split()[0] for text in more))}"
                     if more else "") for first, *more in alike.values()]


def sentence_of(text: str) -> str:
    """`text` as a sentence; a name such as beta1 keeps its small letter."""
    return f"{text if re.match(r'[a-z_]*[0-9]', text) else text[:1].upper() + text[1:]}."


def verdict_title(verdict: Verdict) -> str:
    """The verdict of a diagnosis as a title."""
    return VERDICTS[verdict][1].capitalize()


def answer_words(probability: float | None, in_library: float | None) -> list[str]:
    """Sentence with the probability of an answer, and the same with its condition; empty where none is stated."""
    if probability is None or in_library is None:
        return []
    alone = "above 0.99" if in_library > 0.99 else f"{in_library:.2f}"
    return [f"Probability of this answer: {probability:.2f}, as on simulated legs; {alone} if the library has the true "
            "causes."]
