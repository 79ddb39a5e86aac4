"""The page as a web application: its files, a stream of events, and what a person may ask for."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from sse_starlette import EventSourceResponse
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from rotcal_ros.compensation.secret import Secret
from rotcal_ros.escapes import printable_data
from rotcal_ros.page.board import Board
from rotcal_ros.page.guard import Guard
from rotcal_ros.page.state import State, changes

STATIC: Final = Path(__file__).with_name("static")
LOOK_PERIOD_S: Final = 0.2
TICK_PERIOD_S: Final = 1.0
"""A viewer hears at least this often that the page is alive."""
ANSWER_TIMEOUT_S: Final = 120.0
MOST_BYTES: Final = 10_000
"""Of a request; none needs more."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a request, in words."""

    success: bool
    message: str


class Actions(Protocol):
    """What a person may ask the cell for; each is done in the cell's own time."""

    def resume(self, instruction: str) -> Future[Answer]:
        """Go on after the work of a person that this instruction asked for, and no other."""

    def stop(self) -> Future[Answer]:
        """End the calibration with a valid bag."""

    def apply(self, confirmation: str, secret: str) -> Future[Answer]:
        """Feed the table with this confirmation to the controller."""


def make_app(board: Board, actions: Actions, host: str, password: Secret | None = None) -> Guard:
    """Return the application, guarded; ``host`` is the interface that it is served on."""

    async def index(_request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def events(_request: Request) -> Response:
        return EventSourceResponse(_events(board, guard.token), ping=15, send_timeout=30, sep="\n")

    async def resume(request: Request) -> Response:
        asked = await _asked(request, "instruction")
        if asked is None:
            return _response(Answer(False, "expected the instruction that was followed"), 400)
        return await _answered(actions.resume(*asked))

    async def stop(_request: Request) -> Response:
        return await _answered(actions.stop())

    async def apply(request: Request) -> Response:
        asked = await _asked(request, "confirmation", "secret")
        if asked is None:
            return _response(Answer(False, "expected a confirmation and a secret"), 400)
        return await _answered(actions.apply(*asked))

    guard = Guard(
        Starlette(
            routes=[
                Route("/", index),
                Route("/events", events),
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


async def _events(board: Board, token: str) -> AsyncIterator[dict[str, str]]:
    """Yield the whole state, then what changes; a tick where nothing does."""
    seen: State | None = None
    sent_s = 0.0
    while seen is None or not seen.ended:
        state = board.state
        if state is not seen:
            data = {**changes(seen, state), "time_s": time.time()}
            yield _event("change" if seen else "state", data if seen else {**data, "token": token})
            seen, sent_s = state, time.monotonic()
        elif time.monotonic() - sent_s >= TICK_PERIOD_S:
            yield _event("tick", {"time_s": time.time()})
            sent_s = time.monotonic()
        await asyncio.sleep(LOOK_PERIOD_S)


def _event(name: str, data: dict[str, Any]) -> dict[str, str]:
    return {"event": name, "data": json.dumps(printable_data(data), allow_nan=False)}


async def _asked(request: Request, *names: str) -> tuple[str, ...] | None:
    """Return the texts that a request carries as JSON, None when it is another one."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BYTES:
            return None
    try:
        found = json.loads(body)
        texts = tuple(found[name] for name in names)
    except (ValueError, TypeError, KeyError):
        return None
    return texts if all(isinstance(text, str) for text in texts) else None


async def _answered(future: Future[Answer]) -> Response:
    try:
        # Shielded: the cell could not give its late answer to a future that was canceled.
        waiting = asyncio.shield(asyncio.wrap_future(future))
        answer = await asyncio.wait_for(waiting, ANSWER_TIMEOUT_S)
    except asyncio.TimeoutError:
        return _response(Answer(False, "no answer from the cell"), 504)
    return _response(answer, 200 if answer.success else 409)


def _response(answer: Answer, status: int) -> Response:
    return JSONResponse({"success": answer.success, "message": answer.message}, status)
