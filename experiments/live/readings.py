"""Text of the page for a session: `readings` makes the document that `page.js` puts into the page."""

from __future__ import annotations

import math
import time
from typing import Any

from daq import Limits, Rig
from daq.recording import WATCHED
from experiments.live.session import Phase, Session

STALE_S = 1.0
"""A recorder that says nothing for so long is said to be silent."""
TONES = {
    Phase.IDLE: "calm", Phase.OPENING: "busy", Phase.RECORDING: "live", Phase.STOPPING: "busy", Phase.FINISHED: "good",
    Phase.STOPPED: "calm", Phase.LIMIT: "bad", Phase.LOST: "bad", Phase.OVERLOAD: "bad", Phase.FAILED: "bad",
    Phase.EMERGENCY: "bad"}
NONE = "–"


def limit_rows(limits: Limits) -> list[tuple[str, str, float]]:
    """(id, what is limited with its unit, the limit) in the order of the supervisor."""
    return [(f"limit-{name}", f"{what[0].upper()}{what[1:]}", float(getattr(limits, limit)))
            for name, limit, what in WATCHED]


def readings(session: Session, rig: Rig, shown_rows: int) -> dict[str, Any]:
    """State, numbers and the rows that come after the first `shown_rows` of this run."""
    new = min(session.rows_seen - shown_rows, len(session.rows))
    rows = list(session.rows)[-new:] if new > 0 else []
    bars, limits = _limits(session, rig)
    drive, drive_words = drive_of(session)
    flawed = session.phase is Phase.FINISHED and session.flaw
    return {
        "drive": drive, "driveWords": drive_words, "tone": "busy" if flawed else TONES[session.phase],
        "phase": session.phase.value, "words": session.words, "running": session.running,
        "latched": session.latched, "run": session.run_number,
        "progress": _progress(session), "text": _devices(session, rig) | limits, "bars": bars,
        "rows": [[None if v is None or not math.isfinite(v) else round(v, 5) for v in row] for row in rows]}


def drive_of(session: Session) -> tuple[str, str]:
    """(off | armed | driving | unknown, one or two words): whether the leg may move, to be read from across a room.

    What is not known counts as dangerous: before the controller was heard, when the recorder is silent, and after a run
    whose end the controller did not confirm.
    """
    status = session.status
    if not session.running:
        if not session.motor:
            return "off", "NOT DRIVEN"
        return ("off", "MOTOR OFF") if session.motor.startswith("torque off") else ("unknown", "UNCLEAR")
    if status is None or status.phase == "opening" or time.monotonic() - session.heard_s > STALE_S:
        return "unknown", "UNCLEAR"
    if status.phase == "driving":
        return "driving", "DRIVING"
    return ("armed", "ARMED") if status.controller.startswith("armed") else ("off", "MOTOR OFF")


def _progress(session: Session) -> float:
    status = session.status
    return status.done_s / status.total_s if status is not None and status.total_s else 0.0


def _devices(session: Session, rig: Rig) -> dict[str, str]:
    status = session.status
    text = {"motor": session.motor or ("under the recorder's control" if session.running else "not driven from here"),
            "clock": NONE, "drops": NONE, "time": NONE, "silence": ""}
    lost = session.phase is Phase.LOST
    closed = "closed: a recording opens it" if session.status is None else "closed"
    text["controller"] = text["imu"] = closed
    if rig.devices.imu is None:
        text["imu"] = "none in the rig file"
    if status is None or status.phase == "opening":
        if session.running:
            text["controller"] = text["imu"] = "opening"
        return text
    text["time"] = f"{status.done_s:.1f} of {status.total_s:.1f} s"
    if status.clock_bound_s is not None:
        text["clock"] = f"{status.clock_bound_s * 1e6:.0f} µs"
    dropped = status.frames_lost + status.frames_bad + status.imu_gaps
    text["drops"] = (f"{dropped or 'none'}: telemetry {status.frames_lost} lost, "
                     f"{status.frames_bad} damaged; IMU gaps {status.imu_gaps}; commands left out as late "
                     f"{status.late_commands}")
    if session.running:
        text["controller"] = f"{status.controller}, heard {_age(status.controller_age_s)} ago"
        if rig.devices.imu is not None:
            text["imu"] = f"{status.imu_samples} samples, heard {_age(status.imu_age_s)} ago"
        quiet = time.monotonic() - session.heard_s
        if quiet > STALE_S:
            text["silence"] = f"No message from the recorder for {quiet:.0f} s: the values shown are old."
    elif session.phase is Phase.OVERLOAD:
        text["controller"] = text["imu"] = "closed; the computer was too busy to listen"
    elif lost:
        words = session.words.lower()
        text["imu" if "imu" in words or "lsm9ds1" in words else "controller"] = "LOST"
    return text


def _age(seconds: float | None) -> str:
    return "never" if seconds is None else f"{max(seconds, 0.0) * 1e3:.0f} ms"


def _limits(session: Session, rig: Rig) -> tuple[dict[str, float], dict[str, str]]:
    """Shares of the limits used, and the values, by id."""
    watched = {what: value for _, what, value, _ in session.status.watched} if session.status else {}
    bars, text = {}, {}
    for name, limit, what in WATCHED:
        value = watched.get(what)
        text[f"limit-{name}"] = NONE if value is None else _figure(value)
        size = 0.0 if value is None else value if limit == "temperature_degc" else abs(value)
        bars[f"limit-{name}"] = min(max(size / float(getattr(rig.limits, limit)), 0.0), 1.0)
    return bars, text


def _figure(value: float) -> str:
    """Enough digits to read while they change."""
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.3f}" if abs(value) >= 0.01 else f"{value:.4f}"
