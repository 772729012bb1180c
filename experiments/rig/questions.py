"""`legid init` by asking: one question a line, Enter takes what stands in brackets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from daq import InputError
from experiments.rig.writer import RigFacts, default_actuated

T = TypeVar("T")
MODELS = ("leg2", "biped3", "joint1", "chain")


def ask_facts(facts: RigFacts, ask: Callable[[str], str] | None = None) -> RigFacts:
    """`facts` as somebody corrects them. Raises `InputError` where the answers end early."""
    def get(field: str, question: str, read: Callable[[str], Any], shown: str | None = None) -> None:
        nonlocal facts
        value = getattr(facts, field)
        given = _answer(f"{question} [{shown if shown is not None else value}]: ", read, ask or input)
        known = facts.known | {field}
        facts = replace(facts, known=known) if given is None else replace(facts, known=known, **{field: given})

    get("model", f"mechanism, {' | '.join(MODELS)}", _model)
    if facts.model == "chain":
        get("links", "number of links", _whole(1, 20))
    facts = replace(facts, actuated=default_actuated(facts.model, facts.links))
    get("actuated", "joints with a motor whose torque is measured", _joints, " ".join(map(str, facts.actuated)))
    get("gravity_mps2", "gravity [m/s2]", _number)
    if facts.model == "leg2":
        get("lever_arm_m", "pivot to IMU along link 1 [m]", _number)
        get("bus", "I2C bus of the IMU, or none", _name, facts.bus or "/dev/i2c-1")
        facts = replace(facts, bus=_named(facts.bus, "/dev/i2c-1"))
    get("gear_ratio", "gear ratio of the motor", _positive)
    get("torque_constant_nm_per_a", "joint torque per ampere of motor current, gear included [N m/A]", _positive)
    get("port", "serial port of the controller, a CAN channel like can0, or none (files alone)", _name,
        facts.port or "/dev/ttyACM0")
    place = _named(facts.port, "/dev/ttyACM0")
    if place is not None and "/" not in place:
        facts = replace(facts, port=None, can_channel=place)
        get("node", "the controller's node on CAN", _whole(0, 63))
    elif place is None:
        return replace(facts, port=None, records=False)
    else:
        facts = replace(facts, port=place)
    get("rate_hz", "telemetry rate of the controller [Hz]", _positive)
    get("torque_nm", "torque limit at the joint [N m]", _positive)
    get("speed_radps", "speed limit [rad/s]", _positive)
    get("q1_rad", "angle limit of the first joint [rad]", _positive)
    get("q2_rad", "angle limit of the second joint [rad]", _positive)
    return facts


def _answer(question: str, read: Callable[[str], T], ask: Callable[[str], str]) -> T | None:
    """None for Enter; asks again what cannot be used."""
    while True:
        try:
            text = ask(question).strip()
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
