"""An emulated rig's file, rewritten for another drive than our own firmware."""

from __future__ import annotations

import json
import socket
from typing import Any

from daq import InputError
from drivers import DriverError
from drivers.mock import drive_facts


def rig_with_drive(text: str, kind: str, can: str = "") -> str:
    """The rig file `text` of an emulated rig with a drive of this kind; `can`: python-can's settings in place of a
    port. Raises `InputError` where there is no such drive, or no emulator of it."""
    if kind == "legid":
        return text
    try:
        facts = drive_facts(kind)
    except DriverError as error:
        raise InputError("--drive", str(error), "name one that there is") from None
    lines = [f'kind = "{kind}"', f"node = {facts.node}"] + ([f"can = {can}"] if can else [])
    out = []
    for line in text.splitlines():
        if line.startswith("rate_hz") and "[devices.controller]" in out:
            line = f"rate_hz = {facts.rate_hz:.1f}" if "[limits]" not in out else line
        if can and line.startswith("port ="):
            continue
        out.append(line)
        out += lines if line == "[devices.controller]" else []
        out += ['unchecked = ["encoder_s"]            # this drive reads the knee by one sensor'] \
            if line == "[limits]" else []
    return "\n".join(out) + "\n"


def local_can() -> dict[str, Any]:
    """python-can's settings of a CAN bus on this machine alone: frames in UDP datagrams, on a port that is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    return {"interface": "udp_multicast", "channel": "239.74.163.2", "port": port, "hop_limit": 0}


def toml_of(settings: dict[str, Any]) -> str:
    """An inline table of TOML."""
    return "{" + ", ".join(f"{key} = {json.dumps(value)}" for key, value in settings.items()) + "}"
