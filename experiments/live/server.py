"""The dashboard's web server: one page, the emergency stop, the reports."""

from __future__ import annotations

import ipaddress
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI, HTTPException, Request
from fastapi.responses import FileResponse
from nicegui import ui

from daq import InputError, RigFile
from experiments.live.access import SANDBOX, Access, is_loopback, new_token
from experiments.live.bench import Bench
from experiments.live.page import Page
from experiments.reports import script_hash

HISTORY = 100
"""Messages kept for a browser that comes back."""
LEAVE_S = 2
WHO = "x-legid-who"
"""Header with the random name that a browser gave itself: another browser cannot release its emergency stop."""


def serve(rig: RigFile, plans: Path, out: Path, host: str, port: int, with_token: bool = False) -> None:
    """Serve the dashboard of the rig until a signal. Raises `InputError` when the port cannot be had.

    A token is asked for on any host but this machine's own, and there with `with_token`.
    """
    listener = listen(host, port)
    bound = listener.getsockname()[1]
    token = new_token() if with_token or not is_loopback(host) else None
    bench = Bench(rig, plans, out)
    app = Access(build_app(bench), token, bound)
    config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=LEAVE_S, ws_ping_interval=5.0)
    where = _address(host) + f":{bound}/" + (f"?token={token}" if token else "")
    print(f"legid live: http://{where} (Ctrl-C ends it)", flush=True)
    with suppress(KeyboardInterrupt):  # uvicorn raises it again when all is closed
        _hurry()
        _Server(config, bench).run(sockets=[listener])


def _hurry() -> None:
    """Raise this thread's priority, if permitted, above ordinary programs and below a recorder.

    Processes started from here have ordinary priority again.
    """
    with suppress(OSError, AttributeError):  # AttributeError: a system without these calls
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def build_app(bench: Bench) -> FastAPI:
    """All routes."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        yield
        await bench.close()

    app = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)

    @app.post("/emergency")
    async def emergency(request: Request) -> dict[str, str]:
        """Does not wait for anything: the recorder is told before the answer is written."""
        bench.session.emergency(request.headers.get(WHO, ""))
        return {"phase": bench.session.phase.value}

    @app.post("/release")
    async def release(request: Request) -> dict[str, str]:
        """For who pressed the emergency stop, and for whoever sits at this machine."""
        at_machine = request.client is not None and is_loopback(request.client.host)
        if not bench.session.release(request.headers.get(WHO, ""), at_machine):
            raise HTTPException(403, "only who pressed the emergency stop, or somebody at the machine, can release it")
        return {"phase": bench.session.phase.value}

    @app.post("/stop")
    async def stop() -> dict[str, str]:
        """A controlled stop, by a plain request like the emergency stop."""
        bench.session.stop()
        return {"phase": bench.session.phase.value}

    @app.post("/here")
    async def here() -> dict[str, bool]:
        """A page that somebody can see says so, four times a second, and hears which buttons it needs."""
        bench.session.page_heard()
        return bench.session.control

    @app.get("/report/{name}")
    async def report(name: str) -> FileResponse:
        found = bench.report(name)
        if found is None:
            raise HTTPException(404, "no such report")
        policy = SANDBOX.format(script=script_hash())
        return FileResponse(found, media_type="text/html", headers={"content-security-policy": policy})

    @ui.page("/")
    def index() -> None:
        Page(bench).build()

    ui.run_with(app, title="legid live", dark=None, tailwind=False, reconnect_timeout=3.0,
                message_history_length=HISTORY, show_welcome_message=False, binding_refresh_interval=None)
    return app


def listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises `InputError` naming the remedy."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()  # who opens the printed address at once waits, and is not refused
    except socket.gaierror:
        raise InputError("--host", f"{host} is no address", "give one of this machine's, e.g. 0.0.0.0") from None
    except OSError as error:
        raise InputError("--port", f"cannot listen on {host} port {port}: {error.strerror}",
                         "give another, or 0 for any that is free") from None
    return listener


class _Server(uvicorn.Server):
    """A signal stops the motor first."""

    def __init__(self, config: uvicorn.Config, bench: Bench) -> None:
        super().__init__(config)
        self._bench = bench

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._bench.session.stop()
        super().handle_exit(sig, frame)


def _address(host: str) -> str:
    """As it stands in a URL; for 'every address' the machine's name."""
    try:
        number = ipaddress.ip_address(host)
    except ValueError:
        return host
    if number.is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if number.version == 6 else host
