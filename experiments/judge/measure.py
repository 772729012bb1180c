"""The next value to measure after a fit, in a sentence."""

from __future__ import annotations

from estimator import FitResult
from estimator.effects import classes
from estimator.fitting import CALIBRATED, Measurement, body_unit

CALIBRATIONS = {"torque_gain": "legid calibrate shunt --weight", "imu_lever_arm": "a ruler"}
"""Source of the budget -> how to calibrate it, where its effect does not say."""
HOW = {"l": "with a ruler, joint to joint", "m": "on a scale", "lc": "by balancing the link on an edge",
       "I": "by swinging the link as a pendulum"}


def measure_sentence(result: FitResult, found: Measurement) -> str:
    """The next value to measure, its benefit, and what to write."""
    if found.source:
        return _calibrate(result, found)
    name, unit = found.name, _unit(result, found.name)
    m = result.mechanism
    meaning = f" ({m.parameters[m.column(name)].meaning})" if name in m.names else ""
    how = HOW.get(name.rstrip("0123456789"), "")
    text = f"Measure {name}{meaning} {how}".rstrip() + f" to +- {found.std:.2g} {unit}".rstrip()
    before, after = found.undetermined
    if after < before:
        text += f": of {before} open combinations {after or 'none'} would remain"
    else:
        best, share = min(found.widths.items(), key=lambda pair: pair[1])
        text += (f": the other intervals would shrink to {100 * found.share:.0f} % of their width on average, that of "
                 f"{best} to {100 * share:.0f} %")
    return f"{text}. Write {name} = [VALUE, {found.std:.2g}] under [prior]{_or_zero(result, found)}."


def _calibrate(result: FitResult, found: Measurement) -> str:
    """Of a source of the budget: which, how, and what it does."""
    name, _, joint = found.name.partition("@")
    part = result.budget.part(found.name) if result.budget else None
    left = [f"{CALIBRATED * one:.2g}" for one in (part.tolerance if part else ())]
    kind = next((kind for kind in classes() if kind.name == name), None)
    how = CALIBRATIONS.get(name) or (kind.by_hand or kind.experiment if kind else "")
    best, share = min(found.widths.items(), key=lambda pair: pair[1])
    key, value = ".".join(filter(None, (name, joint))), left[0] if len(left) == 1 else f"[{', '.join(left)}]"
    return (f"Calibrate {found.name.replace('@', ' of joint ')} ({how}) to +- {found.std:.2g}: the intervals would "
            f"shrink to {100 * found.share:.0f} % of their width on average, that of {best} to {100 * share:.0f} %. "
            f"Write {key} = {value} under [tolerance].")


def _or_zero(result: FitResult, measurement: Measurement) -> str:
    """Of the coupling of two links: when it is zero."""
    m = result.mechanism
    p = m.parameters[m.column(measurement.name)] if measurement.name in m.names else None
    if p is None or p.term != "inertia" or p.at[0] == p.at[-1]:
        return ""
    i = p.at[0] + 1
    return f", or --fix {measurement.name}=0 where joints {i} and {i + 1} share an axis"


def _unit(result: FitResult, name: str) -> str:
    m = result.mechanism
    return m.parameters[m.column(name)].unit if name in m.names else body_unit(name)
