"""Who may look into the dashboard, and what it answers to nonsense."""

import asyncio
import select
import socket
from pathlib import Path

import msgspec
import pytest

from daq import InputError
from daq.recording import PACKET_BYTES, Ended, Heard, Status, watched_by
from drivers import DeviceAbsent
from drivers.errors import DeviceBusy
from experiments.live.access import Access, is_loopback
from experiments.live.session import Phase, Session
from tests.support.shell import Shell

RIG = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n[devices.imu]\n[devices.controller]\n'


def test_only_who_pressed_releases_or_somebody_at_the_machine(tmp_path: Path) -> None:
    session = Session(tmp_path / "rig.toml", tmp_path)
    session.emergency("a1")
    assert session.latched and session.phase is Phase.EMERGENCY
    assert not session.release("b2") and not session.release("") and session.latched
    session.emergency("b2")
    assert session.release("b2") and session.latched  # the other has pressed, too
    assert session.release("a1") and not session.latched
    assert session.phase is Phase.IDLE
    session.emergency()
    assert not session.release("") and session.latched
    assert session.release("", at_machine=True) and not session.latched


# -- who may look in -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("host, own", [
    ("127.0.0.1", True), ("localhost", True), ("::1", True), ("[::1]", True), ("0.0.0.0", False),
    ("192.168.1.5", False), ("127.0.0.1.example", False), ("", False)])
def test_only_this_machines_names_are_its_own(host: str, own: bool) -> None:
    assert is_loopback(host) is own


@pytest.mark.parametrize("kind, headers, token, passes", [
    ("websocket", {"host": "localhost:1"}, None, True),
    ("websocket", {"host": "localhost:1", "origin": "http://localhost:1"}, None, True),
    ("websocket", {"host": "localhost:1", "origin": "http://evil.example"}, None, False),
    ("websocket", {"host": "evil.example"}, None, False),
    ("websocket", {"host": "leg:1", "cookie": "legid_live_1=s3"}, "s3", True),
    ("websocket", {"host": "leg:1", "cookie": "legid_live_1=s4"}, "s3", False),
    ("websocket", {"host": "leg:1"}, "s3", False), ("http", {"host": "leg:1"}, "s3", False),
    ("http", {"host": "leg:1", "cookie": "legid_live_1=s3; other=1"}, "s3", True),
    ("http", {"host": "leg:1", "cookie": "legid_live_1=é"}, "s3", False)])
def test_sockets_and_pages_of_strangers_are_refused(kind: str, headers: dict[str, str], token: str | None,
                                                    passes: bool) -> None:
    reached, sent = [], []

    async def app(*_: object) -> None:
        reached.append(kind)

    async def send(message: dict) -> None:
        sent.append(message)

    scope = {"type": kind, "path": "/", "query_string": b"",
             "headers": [(k.encode(), v.encode("latin-1")) for k, v in headers.items()]}
    asyncio.run(Access(app, token, 1)(scope, None, send))  # type: ignore[arg-type]
    assert bool(reached) is passes
    assert passes or sent[0].get("status", 403) == 403


def test_without_the_extra_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch, shell: Shell) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    shell("live --demo", status=1)
    assert shell.err == "legid live: needs the extra: pip install legid[live]\n"


def test_bad_arguments_are_one_line(here: Path, shell: Shell) -> None:
    pytest.importorskip("nicegui")
    live = "live --out o --rig"
    assert "none.toml" in shell.fails(live, "none.toml")
    (here / "rig.toml").write_text(RIG)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert "give another, or 0" in shell.fails(live, "rig.toml --port", port)
    assert "--host" in shell.fails(live, "rig.toml --host nowhere.invalid")


@pytest.mark.parametrize("error, kind", [
    (InputError("plan.csv, line 3", "time runs backwards", "sort it"), "failed"),
    (DeviceAbsent("leg controller on /dev/x: no such port; plug it in"), "lost"),
    (DeviceBusy("leg controller on /dev/x: another program holds the port; close it"), "failed")])
def test_what_ends_a_run_before_it_began_reaches_the_watcher(error: Exception, kind: str) -> None:
    watcher, line = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with watcher:
        with pytest.raises(type(error)), watched_by(line.detach()):
            raise error
        packets = []
        while select.select([watcher], [], [], 1.0)[0] and (packet := watcher.recv(PACKET_BYTES)):
            packets.append(msgspec.json.decode(packet, type=Status | Heard | Ended))
    assert packets[-1] == Ended(kind, str(error), "never driven")  # type: ignore[arg-type]
