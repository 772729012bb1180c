"""Access to the page: this machine, or whoever has the token. No page of another site may speak to it."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
TOKEN_BYTES = 24
POLICY = ("default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
          "img-src 'self' data:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
          "form-action 'self'; frame-ancestors 'none'")
"""Nothing is loaded from, or sent to, another place. NiceGUI compiles its templates in the browser: hence the eval."""
SANDBOX = ("sandbox allow-scripts; default-src 'none'; script-src '{script}'; img-src data:; "
           "style-src 'unsafe-inline'; font-src data:")
"""For reports besides: any file of that name would otherwise act with the dashboard's rights. A report is a stranger to
this page (no `allow-same-origin`), can ask for nothing, and of scripts runs the one alone that zooms its figures."""


def is_loopback(host: str) -> bool:
    """The name or address is this machine's own."""
    if host in ("localhost", "localhost."):
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """Random, for a URL."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Access:
    """ASGI middleware over everything: pages, files, sockets.

    Without a token only a browser that calls this machine by a name of its own is served (a name that another site
    points here is not). With one, it is taken from the URL once and kept in a cookie.
    """

    def __init__(self, app: App, token: str | None, port: int) -> None:
        self.app, self._token = app, token
        self._cookie = f"legid_live_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)
        given = dict(query).get("token", "")
        if not self._friendly(headers):
            await _refuse(scope, send, "this page answers to its own address only")
        elif self._token is None or self._matches(self._kept(headers)):
            await self.app(scope, receive, _with_policy(send))
        elif self._matches(given) and scope["type"] == "http":
            rest = urlencode([(key, value) for key, value in query if key != "token"])
            where = "/" + scope["path"].lstrip("/") + (f"?{rest}" if rest else "")
            await _redirect(send, where, f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Lax")
        else:
            await _refuse(scope, send, "open the address that legid live printed, with its token")

    def _matches(self, given: str) -> bool:
        return self._token is not None and secrets.compare_digest(given.encode(), self._token.encode())

    def _kept(self, headers: dict[str, str]) -> str:
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return cookie.value if cookie else ""

    def _friendly(self, headers: dict[str, str]) -> bool:
        host, origin = headers.get("host", ""), headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        return self._token is not None or is_loopback(urlsplit(f"//{host}").hostname or "")


def _with_policy(send: Send) -> Send:
    async def forward(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), (b"content-security-policy", POLICY.encode()),
                                  (b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
        await send(message)

    return forward


async def _redirect(send: Send, path: str, cookie: str) -> None:
    await send({"type": "http.response.start", "status": 303,
                "headers": [(b"location", path.encode()), (b"set-cookie", cookie.encode()),
                            (b"referrer-policy", b"no-referrer"), (b"content-length", b"0")]})
    await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, send: Send, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    body = f"403: {why}\n".encode()
    await send({"type": "http.response.start", "status": 403,
                "headers": [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", b"%d" % len(body))]})
    await send({"type": "http.response.body", "body": body})
