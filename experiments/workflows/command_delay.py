"""`find_late_commands`: the delay of commands that a rig file does not state, by its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daq import Dataset, Rig
from estimator import FitError
from estimator.fitting import find_command_delay
from experiments.session import Choice, prepare, with_choices

ROUNDS, SMALL_S = 3, 2e-4
"""Most times that a delay of commands is sought, and one that needs no further round [s]."""


def find_late_commands(datasets: Sequence[Dataset], rig: Rig, sensors: str | None = None) -> Choice | None:
    """`[servo] delay_s` by the motion of joints whose loop makes the torque; None where `rig` states it, or the runs
    show none.

    Each round makes the torque anew of the commands as they act, so that no other term takes the delay's place.
    """
    if rig.servo is None or rig.servo.delay_s is not None:
        return None
    late = 0.0
    for _ in range(ROUNDS):
        setup = prepare(datasets, with_choices(rig, [_choice(late)]), sensors=sensors).setup
        if not setup.mechanism.followers:
            return None
        try:
            more = find_command_delay(setup.datasets, setup.mechanism, replace(setup.options, unknown_delay=True))
        except FitError:
            return None
        if more is None:
            return None
        late += more
        if abs(more) < SMALL_S:
            break
    return None if abs(late) < SMALL_S else _choice(round(late, 5))


def _choice(late_s: float) -> Choice:
    return Choice("servo", "delay_s", late_s, "commands that act late", "the likeliest delay, uncertain in the fit")
