"""Precision of the parameters of a fit, and the parts of its uncertainty budget."""

from __future__ import annotations

from estimator import FitResult

PARTS_TOLD = 3
"""Most sources that a sentence names."""
LEAST_PART = 0.1
"""Least share of the interval of a source that is named."""
WORDS = {"torque_gain": "torque constant", "scatter": "scatter between runs", "structure": "unnamed structure",
         "step": "suggested laws", "imu_lever_arm": "lever arm"}
"""Source -> its words, where they are not its name."""


def source_words(source: str) -> str:
    """A source for a person: "joint stiffness 2"."""
    name, _, joint = source.partition("@")
    words = WORDS.get(name, name.replace("_", " ")).replace("imu ", "IMU ")
    return f"{words} {joint}".strip()


def leading(result: FitResult) -> int | None:
    """Number of the parameter that stands for all: the first of the rigid ones that was estimated and is not zero."""
    for k, p in enumerate(result.mechanism.parameters):
        if p.rigid and p.name not in {*result.fixed, *result.at_bound, *result.open_parameters} and result.beta[k]:
            return k
    return None


def parts_of(result: FitResult, k: int) -> dict[str, float]:
    """Source -> half of the 95 % interval of parameter number k that it would make alone, the largest first."""
    if result.budget is None:
        return {}
    scale = float(result.half_width[k] / result.std[k]) if result.std[k] > 0.0 else 0.0
    found = {part.source: scale * float(part.std[k]) for part in result.budget.parts}
    return dict(sorted(found.items(), key=lambda pair: -pair[1]))


def precision(result: FitResult) -> str:
    """Precision of the leading parameter and its largest parts; empty without a budget."""
    k = leading(result)
    if result.budget is None or k is None:
        return ""
    value = abs(float(result.beta[k]))
    half, parts = float(result.half_width[k]), parts_of(result, k)
    told = [f"{source_words(source)} {_percent(part / value)}" for source, part in parts.items()
            if part > LEAST_PART * half]
    noise = [f"noise {_percent(parts['noise'] / value)}"] if parts["noise"] <= LEAST_PART * half else []
    if half > value:  # a share of more than the whole says nothing
        return f"{result.mechanism.names[k]} is not known: its interval is wider than its value"
    return (f"{result.mechanism.names[k]} is known to {_percent(half / value)} "
            f"({', '.join([*told[:PARTS_TOLD], *noise])})")


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.0f} %"
