"""The page as a web application: its files, a stream of events, and a person's requests.

It is served from a thread of its own. A request must name this host, carry the password if there
is one, and come from no other site. A page of another site, open in the same browser, can send
requests to this one. But it cannot read the token, the browser states its origin, and a foreign
host name that was made to point to this machine is not accepted.
"""

from __future__ import annotations

import asyncio
import base64
import hmac
import json
import socket
import time
from collections.abc import AsyncIterator, Collection
from concurrent.futures import Future
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from secrets import token_urlsafe
from threading import Thread
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

import uvicorn
from sse_starlette import EventSourceResponse
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rotcal_ros.compensation.secret import Secret
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.escapes import printable_data
from rotcal_ros.foundation.language import language, language_codes, phrase
from rotcal_ros.foundation.untrusted import load_json
from rotcal_ros.page.settings import LOOPBACK, PageSettings
from rotcal_ros.page.state import PageState, StateBoard, json_value, state_changes

STATIC: Final = Path(__file__).with_name("static")
LOOK_PERIOD_S: Final = 0.2
TICK_PERIOD_S: Final = 1.0
"""Longest time until a viewer hears that the page is alive."""
ANSWER_TIMEOUT_S: Final = 120.0
MOST_BYTES: Final = 10_000
"""Most bytes of a request; none needs more."""


@dataclass(frozen=True, slots=True)
class ActionOutcome:
    """The outcome of a request, in words."""

    success: bool
    message: str


class OperatorActions(Protocol):
    """The requests of a person to the cell; each takes its time."""

    def resume(self, instruction: str) -> Future[ActionOutcome]:
        """Go on after the work that this instruction asked for, and no other."""

    def stop(self) -> Future[ActionOutcome]:
        """End the calibration with a valid bag."""

    def apply(self, confirmation: str, secret: str) -> Future[ActionOutcome]:
        """Feed the table with this confirmation to the controller."""


def make_app(
    board: StateBoard, actions: OperatorActions, host: str, password: Secret | None = None
) -> RequestGuard:
    """Return the application, guarded; ``host`` is the interface that it is served on."""

    async def index(_request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def events(_request: Request) -> Response:
        return EventSourceResponse(_events(board, guard.token), ping=15, send_timeout=30, sep="\n")

    async def resume(request: Request) -> Response:
        asked = await _asked(request, "instruction")
        if asked is None:
            return _response(
                ActionOutcome(False, phrase("expected the instruction that was carried out")), 400
            )
        return await _answered(actions.resume(*asked))

    async def stop(_request: Request) -> Response:
        return await _answered(actions.stop())

    async def apply(request: Request) -> Response:
        asked = await _asked(request, "confirmation", "secret")
        if asked is None:
            return _response(
                ActionOutcome(False, phrase("expected a confirmation and a secret")), 400
            )
        return await _answered(actions.apply(*asked))

    guard = RequestGuard(
        Starlette(
            routes=[
                Route("/", index),
                Route("/events", events),
                Route("/words", translation_catalogues),
                Route("/resume", resume, methods=["POST"]),
                Route("/stop", stop, methods=["POST"]),
                Route("/apply", apply, methods=["POST"]),
                Mount("/static", StaticFiles(directory=STATIC)),
            ]
        ),
        password,
        host,
    )
    return guard


async def translation_catalogues(_request: Request) -> Response:
    """Answer with the catalogues of all languages but English."""
    return JSONResponse({code: language(code).texts for code in language_codes()[1:]})


async def _events(board: StateBoard, token: str) -> AsyncIterator[dict[str, str]]:
    """Yield the whole state, then what changes; a tick where nothing does."""
    seen: PageState | None = None
    sent_s = 0.0
    while seen is None or not seen.ended:
        state = board.state
        if state is not seen:
            data = {**state_changes(seen, state), "time_s": time.time()}
            yield _event("change" if seen else "state", data if seen else {**data, "token": token})
            seen, sent_s = state, time.monotonic()
        elif time.monotonic() - sent_s >= TICK_PERIOD_S:
            yield _event("tick", {"time_s": time.time()})
            sent_s = time.monotonic()
        await asyncio.sleep(LOOK_PERIOD_S)


def _event(name: str, data: dict[str, Any]) -> dict[str, str]:
    return {"event": name, "data": json.dumps(printable_data(data), allow_nan=False)}


async def _asked(request: Request, *names: str) -> tuple[str, ...] | None:
    """Return the texts that a request carries as JSON, None for any other request."""
    found = await json_fields(request, MOST_BYTES)
    texts = tuple(text for name in names if isinstance(text := found.get(name), str))
    return texts if len(texts) == len(names) else None


async def json_fields(request: Request, most_bytes: int) -> dict[str, Any]:
    """Return the group of values that a request carries as JSON, empty for any other request."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > most_bytes:
            return {}
    try:
        found = load_json(body)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


async def _answered(future: Future[ActionOutcome]) -> Response:
    try:
        # Shielded: to a canceled future the cell could not give its late answer.
        waiting = asyncio.shield(asyncio.wrap_future(future))
        answer = await asyncio.wait_for(waiting, ANSWER_TIMEOUT_S)
    except asyncio.TimeoutError:
        waited = phrase("no response from the cell for {0} s", f"{ANSWER_TIMEOUT_S:g}")
        return _response(ActionOutcome(False, waited), 504)
    return _response(answer, 200 if answer.success else 409)


def _response(answer: ActionOutcome, status: int) -> Response:
    return JSONResponse({"success": answer.success, "message": json_value(answer.message)}, status)


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


class RequestGuard:
    """Lets through what comes from the page itself; every answer carries HEADERS.

    ``password`` None: everybody who reaches the page may see and use it. ``token`` is new at every
    start; only the page's own stream of events contains it.
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
                given = MutableHeaders(scope=message)
                given.update({name: text for name, text in HEADERS.items() if name not in given})
            await send(message)

        refusal = self._refusal(scope, Headers(scope=scope))
        await (refusal or self._app)(scope, receive, send_guarded)

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """Return the answer to a request that is not let through."""
        host = headers.get("host", "")
        if not _is_ours(host, self._names):
            return PlainTextResponse("this page is not served under that host name", 421)
        if self._password is not None and not _carries(headers, self._password):
            challenge = {"WWW-Authenticate": 'Basic realm="rotcal", charset="UTF-8"'}
            return PlainTextResponse("this page needs the password", 401, challenge)
        if scope["method"] in SAFE:
            return None
        if headers.get("origin", "") != f"http://{host}":
            return PlainTextResponse("the request comes from another page", 403)
        if headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return PlainTextResponse("the request comes from another site", 403)
        if not hmac.compare_digest(headers.get(TOKEN_HEADER, "").encode(), self.token.encode()):
            return PlainTextResponse("the page is outdated: load it again", 403)
        return None


def _is_ours(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header names us; an address cannot be redirected."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if name in names:
            return True
        ip_address(name)
    except ValueError:
        return False
    return True


def _carries(headers: Headers, password: Secret) -> bool:
    """Return whether a request carries the password, whatever user name it gives."""
    scheme, _, text = headers.get("authorization", "").partition(" ")
    try:
        _user, _, given = base64.b64decode(text, validate=True).decode().partition(":")
    except ValueError:  # no base64, no UTF-8, or not even ASCII
        return False
    return scheme.lower() == "basic" and password.is_in(given)


CLOSING_S: Final = 2
"""Time for viewers to hear the end."""
MOST_VIEWERS: Final = 64


class PageServer:
    """Serves a board from its construction on; ``address`` is what a browser opens.

    Raises ConfigurationError when the port is taken or the password cannot be read.
    """

    def __init__(
        self, settings: PageSettings, board: StateBoard, actions: OperatorActions
    ) -> None:
        password = Secret(Path(settings.password_file)) if settings.password_file else None
        host = LOOPBACK if settings.host == "localhost" else settings.host
        listening = listening_socket(host, settings.port)
        port = listening.getsockname()[1]
        self.address = f"http://{_name(host)}:{port}"
        self._board = board
        self._server = uvicorn.Server(
            uvicorn.Config(
                make_app(board, actions, host, password),
                log_level="warning",
                lifespan="off",
                limit_concurrency=MOST_VIEWERS,
                timeout_graceful_shutdown=CLOSING_S,
                server_header=False,
            )
        )
        self._thread = Thread(
            target=self._server.run, args=([listening],), name="page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Tell all viewers that the cell has been switched off, and end."""
        self._board.show(ended=True)
        self._server.should_exit = True

    @property
    def closed(self) -> bool:
        """Whether the server has ended."""
        return not self._thread.is_alive()


def _name(host: str) -> str:
    """Return a host's name for a browser; for all interfaces it is the machine's name."""
    if ip_address(host).is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens; ConfigurationError when the port is taken."""
    family = socket.AF_INET6 if isinstance(ip_address(host), IPv6Address) else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise ConfigurationError(
            f"the page cannot be served on {host}, port {port}: {error.strerror}; choose another "
            "page.port, or 0 for any free one"
        ) from error
    return listening
