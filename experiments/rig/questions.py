"""`legid init` by asking: one question a line, Enter takes what stands in brackets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from daq import JOINTS, InputError
from drivers import drive_kinds, drive_rate_hz
from experiments.rig.writer import RigFacts, default_actuated

T = TypeVar("T")
MODELS = ("leg2", "biped3", "joint1", "chain")


def ask_facts(facts: RigFacts) -> RigFacts:
    """`facts` as somebody corrects them; what Enter keeps counts as assumed.

    The drive decides what is asked after it: without one there is nothing to record with. Raises `InputError` where the
    answers end early.
    """
    def get(field: str, question: str, read: Callable[[str], Any], shown: str | None = None) -> None:
        nonlocal facts
        value = getattr(facts, field)
        given = _answer(f"{question} [{shown if shown is not None else value}]: ", read)
        if given is not None:
            facts = replace(facts, known=facts.known | {field}, **{field: given})

    get("model", f"mechanism, {' | '.join(MODELS)}", _model)
    if facts.model == "chain":
        get("links", "number of links", _whole(1, 20))
    facts = replace(facts, actuated=default_actuated(facts.model, facts.links))
    get("actuated", "joints with a motor", _joints, " ".join(map(str, facts.actuated)))
    get("gravity_mps2", "gravity [m/s2]", _number)
    if facts.model == "leg2":
        get("lever_arm_m", "pivot to IMU along link 1 [m]", _number)
        get("bus", "I2C bus of the IMU, or none", _name, facts.bus or "/dev/i2c-1")
        facts = replace(facts, bus=_named(facts.bus, "/dev/i2c-1"))
    get("gear_ratio", "gear ratio of the motor", _positive)
    get("kind", f"drive of the motor, {' | '.join(drive_kinds())}, or none (files alone)", _kind)
    if facts.kind == "none":
        return replace(facts, kind="legid", port=None, records=False)
    facts = replace(facts, rate_hz=facts.rate_hz if facts.kind == "legid" else drive_rate_hz(facts.kind))
    get("port", f"where the {facts.kind} drive is: a serial port, or a CAN channel like can0", _place,
        facts.port or "/dev/ttyACM0")
    place = facts.port or "/dev/ttyACM0"
    on_can = "/" not in place and "://" not in place
    facts = replace(facts, port=None, can_channel=place) if on_can else replace(facts, port=place)
    if on_can or facts.kind != "legid":
        get("node", "the drive's node", _whole(0, 252))
    get("torque_constant_nm_per_a", "joint torque per ampere of motor current, gear included [N m/A]", _positive)
    get("rate_hz", "telemetry rate of the drive [Hz]", _positive)
    get("torque_nm", "torque limit at the joint [N m]", _positive)
    get("speed_radps", "speed limit [rad/s]", _positive)
    get("q1_rad", "angle limit of the first joint [rad]", _positive)
    if JOINTS.get(facts.model, facts.links) > 1:
        get("q2_rad", "angle limit of the second joint [rad]", _positive)
    return facts


def _answer(question: str, read: Callable[[str], T]) -> T | None:
    """None for Enter; asks again what cannot be used."""
    while True:
        try:
            text = input(question).strip()
        except EOFError:
            raise InputError("input", "the answers end before the questions",
                             "answer all, or use --defaults or --probe") from None
        if not text:
            return None
        try:
            return read(text)
        except ValueError as error:
            print(f"  {error}")


def _named(given: str | None, default: str) -> str | None:
    """`none` is nothing, nothing is the default."""
    return None if given == "none" else given or default


def _model(text: str) -> str:
    if text not in MODELS:
        raise ValueError(f"{text} is none of {', '.join(MODELS)}")
    return text


def _kind(text: str) -> str:
    if text not in (*drive_kinds(), "none"):
        raise ValueError(f"{text} is none of {', '.join(drive_kinds())}, none")
    return text


def _place(text: str) -> str:
    if text in (*drive_kinds(), "none"):
        raise ValueError(f"{text} is no place: give a serial port like /dev/ttyACM0, or a CAN channel like can0")
    return _name(text)


def _joints(text: str) -> tuple[int, ...]:
    parts = text.replace(",", " ").split()
    if not all(part.isdecimal() and int(part) >= 1 for part in parts):
        raise ValueError(f"{text} is not a list of joints like 1 2")
    return tuple(map(int, parts))


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e9:
        raise ValueError(f"{text} is not a number from 0 on")
    return value


def _positive(text: str) -> float:
    if (value := _number(text)) == 0.0:
        raise ValueError("0 is not possible here")
    return value


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        if not (text.isdecimal() and low <= int(text) <= high):
            raise ValueError(f"{text} is not a whole number from {low} to {high}")
        return int(text)

    return read


def _name(text: str) -> str:
    if any(c in text for c in '"\\ \t'):
        raise ValueError(f"{text} is no name of a device")
    return text
