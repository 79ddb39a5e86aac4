"""Who may ask the page for what: the host by its name, the person by the password, no other site.

A page of another site that a browser shows can send requests to this one. It cannot read the
token, and the browser tells its origin; a name that it lets point here is no name of ours.
"""

from __future__ import annotations

import base64
import hmac
import socket
from collections.abc import Collection
from ipaddress import ip_address
from secrets import token_urlsafe
from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rotcal_ros.compensation.secret import Secret

TOKEN_HEADER: Final = "x-rotcal-token"
HEADERS: Final = {
    "content-security-policy": "default-src 'self'; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'; object-src 'none'",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}
SAFE: Final = ("GET", "HEAD")


class Guard:
    """Lets through what comes from the page itself; every answer carries HEADERS.

    ``password`` None: whoever reaches the page may see and use it. ``token`` is new with every
    start; only the page's own stream of events tells it.
    """

    def __init__(self, app: ASGIApp, password: Secret | None, host: str) -> None:
        self._app = app
        self._password = password
        self._names = {"localhost", host, socket.gethostname().lower()}
        self.token = token_urlsafe()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or say why not."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        headers = Headers(scope=scope)
        refusal = self._refusal(scope["method"], headers)
        await (refusal or self._app)(scope, receive, send_guarded)

    def _refusal(self, method: str, headers: Headers) -> PlainTextResponse | None:
        """Return the answer to a request that is not let through."""
        host = headers.get("host", "")
        if not _is_ours(host, self._names):
            return PlainTextResponse("this page is not served under that name", 421)
        if self._password is not None and not _carries(headers, self._password):
            challenge = {"WWW-Authenticate": 'Basic realm="rotcal", charset="UTF-8"'}
            return PlainTextResponse("the password, please", 401, challenge)
        if method in SAFE:
            return None
        if headers.get("origin", "") != f"http://{host}":
            return PlainTextResponse("the request comes from another page", 403)
        if headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return PlainTextResponse("the request comes from another site", 403)
        if not hmac.compare_digest(headers.get(TOKEN_HEADER, "").encode(), self.token.encode()):
            return PlainTextResponse("the page is an old one: load it again", 403)
        return None


def _is_ours(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header names us: an address cannot be let point elsewhere."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if name in names:
            return True
        ip_address(name)
    except ValueError:
        return False
    return True


def _carries(headers: Headers, password: Secret) -> bool:
    """Return whether a request carries the password, under any name of a user."""
    scheme, _, text = headers.get("authorization", "").partition(" ")
    try:
        _user, _, given = base64.b64decode(text, validate=True).decode().partition(":")
    except ValueError:  # no base64, no UTF-8, or not even ASCII
        return False
    return scheme.lower() == "basic" and password.is_in(given)
