"""Columns that may be the knee's angle or its torque by their names: the equation of motion chooses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from daq import Column, Dataset
from experiments.exchange.guess_physics import Found, Pose, find_knee

CLEARLY = 0.9
"""A rival leaves less than this share of what the likeliest name leaves: copies of one signal leave alike."""
WHAT = {"q2_rad": "the knee's angle", "tau2_nm": "its torque"}


class Rivals(NamedTuple):
    """Further columns of each kind, and where their values are in the run."""

    angles: Sequence[Column]
    torques: Sequence[Column]
    spare: Mapping[str, str]
    """The file's column -> the run's, with plain numbers of torques"""


def best_knee(raw: Dataset, columns: Mapping[str, Column], rivals: Rivals, pose: Pose | None, gravity: float
              ) -> tuple[Found, dict[str, str]]:
    """The knee by the angle and the torque that agree best, and a note for each that had rivals."""
    notes: dict[str, str] = {}
    best, run, used = find_knee(raw, columns, pose, gravity), raw, dict(columns)
    for name, others in (("q2_rad", rivals.angles), ("tau2_nm", rivals.torques)):
        tried = [(best, run, used)]
        for rival in others:
            other = replace(run, columns={**run.columns, name: raw[rivals.spare[rival.name]]})
            tried.append((find_knee(other, {**used, name: rival}, pose, gravity), other, {**used, name: rival}))
        first, least = best.left, min(tried, key=lambda one: one[0].left)
        if others:
            left = ", ".join(f"{with_it[name].name!r} leaves {100 * one.left:.0f} %" for one, _, with_it in tried)
            notes[name] = f"of the columns that may be {WHAT[name]}: {left}"
        if least[0].left < CLEARLY * first:
            best, run, used = least
    return best, notes
