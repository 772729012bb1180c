"""Columns that may be the knee's angle or its torque by their names: the equation of motion chooses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from daq import Column, Dataset, FloatArray
from experiments.exchange.guess_physics import Found, Pose, find_knee

CLEARLY = 0.9
"""A rival leaves less than this share of what the likeliest name leaves: copies of one signal leave alike."""
WHAT = {"q2_rad": "the knee's angle", "tau2_nm": "its torque"}


def best_knee(raw: Dataset, columns: Mapping[str, Column],
              rivals: Mapping[str, Sequence[tuple[Column, FloatArray]]], pose: Pose | None, gravity: float
              ) -> tuple[Found, dict[str, str]]:
    """The knee by the angle and the torque that agree best, and a note for each that had `rivals`: further columns and
    their readings, those of torques as plain numbers."""
    notes: dict[str, str] = {}
    best, run, used = find_knee(raw, columns, pose, gravity), raw, dict(columns)
    for name, others in rivals.items():
        tried = [(best, run, used)]
        for rival, values in others:
            other = replace(run, columns={**run.columns, name: values})
            tried.append((find_knee(other, {**used, name: rival}, pose, gravity), other, {**used, name: rival}))
        first, least = best.left, min(tried, key=lambda one: one[0].left)
        if others:
            left = ", ".join(f"{with_it[name].name!r} leaves {100 * one.left:.0f} %" for one, _, with_it in tried)
            notes[name] = f"of the columns that may be {WHAT[name]}: {left}"
        if least[0].left < CLEARLY * first:
            best, run, used = least
    return best, notes
