"""Uncertainty of the controller's clock in a run, and warnings on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daq.runs import RawRun
from daq.timing import fit_answers, fit_ticks, is_polled

BOUND_S = 1e-3
"""A clock known less well than this is worth a warning: a leg moves in that time."""
GOOD_TIMER_MS = 1


def clock_bound_s(raw: RawRun) -> float:
    """Uncertainty of the controller's clock in the worst boot [s]; 0 without probes."""
    probes = raw.streams["/leg/clock"]
    fit = fit_answers if is_polled(raw) else fit_ticks
    return max((fit(probes[probes["boot_id"] == boot], int(probes["host_tx_ns"][0])).bound_s
                for boot in np.unique(probes["boot_id"])), default=0.0)


def clock_warnings(bound_s: float, link: Mapping[str, object]) -> list[str]:
    """Warnings on a clock bound [s] and on the link's own facts; empty without any."""
    lines = []
    if bound_s > BOUND_S:
        lines.append(f"warning: the controller's clock is known to {bound_s * 1e3:.1f} ms only, more than "
                     f"{BOUND_S * 1e3:g} ms; a skew of that size can pass for friction: use CAN, USB-ACM or a short "
                     "latency timer")
    timer = link.get("latency_timer_ms")
    if isinstance(timer, int) and timer > GOOD_TIMER_MS:
        port = str(link.get("port", "")).rsplit("/", 1)[-1]
        lines.append(f"warning: the serial adapter's latency timer was {timer} ms; "
                     f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{port}/latency_timer")
    return lines
