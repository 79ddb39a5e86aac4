"""The page of ``rotcal web`` as a web application, for one person at this machine.

The address has a key that is good for one browser: it is exchanged for a cookie of the session.
What is dropped lies in one folder, in places of our own choice, and is worked on by one process at
a time, which is ended when it takes too long.
"""

from __future__ import annotations

import asyncio
import hmac
import multiprocessing
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from secrets import token_urlsafe
from typing import Final

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
)
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Scope

from rotcal_ros import page
from rotcal_ros.compensation.controllers import controller_names
from rotcal_ros.compensation.writing import check_file_name
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.files import naming
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.untrusted import LARGEST_FILE
from rotcal_ros.methods.method import DEFAULT
from rotcal_ros.methods.new_setup import OF_THE_ITEM, POSITIONS, START, STEP, known_settings
from rotcal_ros.methods.settings_reference import default_in_words, unit_and_meaning
from rotcal_ros.page.app import (
    CLOSING_S,
    RequestGuard,
    json_fields,
    listening_socket,
    translation_catalogues,
)
from rotcal_ros.page.settings import LOOPBACK
from rotcal_ros.page.state import json_value
from rotcal_tables import table_work
from rotcal_tables.table_work import (
    AFTER,
    FILE_NAMES,
    IN_FORCE,
    METHOD_TITLES,
    REPORT,
    TABLE,
    WORK_FUNCTIONS,
    Reply,
    WorkRequest,
    setting_label,
    settings_on_page,
)

STATIC: Final = Path(__file__).with_name("static")
"""Files of this page; what it shares with the operator's page is there."""
WORK_TIMEOUT_S: Final = 600.0
"""Longest time of one piece of work."""
LARGEST_REQUEST: Final = 1_000_000
"""Most bytes of a request that is no file."""
LONGEST_NAME: Final = 120
TABLE_ANGLE_SETTINGS: Final = (START, STEP, POSITIONS)
AS_IN_TABLE: Final = phrase("as in the table")
"""What stands in an empty box of table angles: nothing of it is sent as a plan."""
REPORT_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'; sandbox allow-popups"
)
"""A report has its style inside, and nothing that runs."""


class WorkProcess:
    """Does one piece of work at a time, each in a process of its own."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([table_work.__name__])
        self._lock = asyncio.Lock()

    async def __call__(self, work: Callable[[WorkRequest], Reply], asked: WorkRequest) -> Reply:
        """Return what the work produces; its errors are reported too."""
        async with self._lock:
            receiver, sender = self._context.Pipe(duplex=False)
            process = self._context.Process(
                target=table_work.run_work, args=(sender, work, asked), daemon=True
            )
            process.start()
            sender.close()
            try:
                reply: Reply = await asyncio.wait_for(
                    asyncio.to_thread(receiver.recv), WORK_TIMEOUT_S
                )
            except asyncio.TimeoutError:
                return _error(f"this takes longer than {WORK_TIMEOUT_S:g} s and was ended")
            except EOFError:
                return _error("the work ended without an answer: perhaps memory ran out")
            finally:
                process.kill()
                process.join()
            return reply


def _error(text: str) -> Reply:
    return {"error": {"text": text, "log": [], "question": None}}


class UploadSession:
    """What one person has dropped into ``folder``, and what was made of it; answers requests.

    ``names`` maps what was dropped to names of files as people know them, ``files`` the names of
    what was made to their places.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._work = WorkProcess()
        self._names: dict[str, str] = {}
        self._files: dict[str, Path] = {}
        self.token = ""

    async def send_start(self, _request: Request) -> Response:
        """Answer with what the page needs once."""
        methods = [(name, json_value(title)) for name, title in METHOD_TITLES.items()]
        return JSONResponse({
            "token": self.token, "names": self._names, "methods": methods, "method": DEFAULT,
            "controllers": controller_names(), "advises": "advise" in plugins.names(plugins.PLANS),
        })  # fmt: skip

    async def receive_file(self, request: Request) -> Response:
        """Keep a file in the place of its role, or forget what is there."""
        role, name = request.path_params["role"], request.query_params.get("name", "")
        if role not in (*FILE_NAMES, IN_FORCE):
            raise ConfigurationError(f"unknown kind of file {role!r:.80}")
        if request.method == "DELETE":
            self._forget(role)
        else:
            with suppress(ClientDisconnect):  # nobody hears the answer
                await self._keep(role, name or role, request)
        return JSONResponse({"names": self._names})

    def _forget(self, role: str) -> None:
        if role in FILE_NAMES:
            (self._folder / FILE_NAMES[role]).unlink(missing_ok=True)
            self._names.pop(role, None)
            self._outdated(role)
        else:
            shutil.rmtree(self._folder / IN_FORCE, ignore_errors=True)

    async def _keep(self, role: str, name: str, request: Request) -> None:
        place = self._folder / (FILE_NAMES.get(role) or f"{IN_FORCE}/{check_file_name(name)}")
        place.parent.mkdir(exist_ok=True)
        part, size = place.with_name(token_urlsafe(9)), 0
        try:
            with naming(place), part.open("wb") as file:
                async for data in request.stream():
                    size += len(data)
                    if size > LARGEST_FILE:
                        raise ConfigurationError(
                            f"{name} has more than the {LARGEST_FILE:,} bytes that we read: split "
                            "it"
                        )
                    file.write(data)
            part.replace(place)
        finally:
            part.unlink(missing_ok=True)  # what was cut off
        if role in FILE_NAMES:
            self._names[role] = printable(name)[:LONGEST_NAME]
            self._outdated(role)

    def _outdated(self, role: str) -> None:
        """Offer nothing more of what was made without this file; a second table makes nothing."""
        if role != AFTER:
            self._files.clear()

    async def do_work(self, request: Request) -> Response:
        """Answer with what becomes of the table, and offer the files that are made."""
        what, options = request.path_params["what"], await json_fields(request, LARGEST_REQUEST)
        if what not in WORK_FUNCTIONS or not options:
            raise ConfigurationError(f"cannot do {what!r:.80} with what was sent")
        if (what != "advise" and TABLE not in self._names) or (
            what == "verify" and AFTER not in self._names
        ):
            raise ConfigurationError("there is no table yet: drop one on the page")
        changes = tuple(map(str, options.get("changes", ())))
        method = str(options.get("method", ""))
        reply = await self._work(
            WORK_FUNCTIONS[what],
            WorkRequest(self._folder, dict(self._names), method, changes, options),
        )
        files = {Path(name).name: self._folder / name for name in reply.get("files", ())}
        self._files |= files
        return JSONResponse({**reply, "files": list(files)}, 422 if reply.get("error") else 200)

    async def send_file(self, request: Request) -> Response:
        """Answer with a file that was made; a report is shown, all else is kept."""
        name = request.path_params["name"]
        if name not in self._files:
            return PlainTextResponse("there is no such file: solve again", 404)
        if name == REPORT:
            policy = {"content-security-policy": REPORT_POLICY}
            return FileResponse(self._files[name], headers=policy)
        return FileResponse(self._files[name], filename=name)


async def _index(_request: Request) -> Response:
    return FileResponse(STATIC / "web.html")


def make_app(folder: Path, port: int) -> SingleBrowserGuard:
    """Return the application, guarded; it keeps its files in ``folder``."""
    session = UploadSession(folder)
    guard = SingleBrowserGuard(
        Starlette(
            routes=[
                Route("/", _index),
                Route("/words", translation_catalogues),
                Route("/start", session.send_start),
                Route("/settings/{method}", _settings),
                Route("/files/{role}", session.receive_file, methods=["POST", "DELETE"]),
                Route("/do/{what}", session.do_work, methods=["POST"]),
                Route("/made/{name}", session.send_file),
                Mount(
                    "/static", StaticFiles(directory=STATIC, packages=[(page.__name__, "static")])
                ),
            ],
            exception_handlers={RotcalError: _refused},
        ),
        port,
    )
    session.token = guard.token
    return guard


async def _refused(_request: Request, error: Exception) -> Response:
    return JSONResponse(_error(str(error)), 400)


async def _settings(request: Request) -> Response:
    return JSONResponse(list(page_settings(request.path_params["method"])))


def page_settings(method: str) -> Iterator[Reply]:
    """Yield what the page asks for, as ``rotcal new`` does, and what certificates need besides."""
    known = known_settings(method)
    for name in settings_on_page(method):
        declared = known[name]
        unit, meaning = unit_and_meaning(declared)
        yield {
            "name": name,
            "meaning": json_value(setting_label(name, meaning)),
            "unit": unit,
            "kind": declared.kind.__name__,
            "list": declared.is_list,
            "choices": declared.info.named_choices,
            "default": json_value(AS_IN_TABLE)
            if name in TABLE_ANGLE_SETTINGS
            else default_in_words(declared),
            "asked": not name.startswith("identity.") or name in OF_THE_ITEM,
        }


class SingleBrowserGuard(RequestGuard):
    """Lets in the one browser that brings ``key`` first, and from then on its cookie."""

    def __init__(self, app: ASGIApp, port: int) -> None:
        super().__init__(app, None, LOOPBACK)
        self.key = token_urlsafe()
        self._hosts = tuple(f"{name}:{port}" for name in (LOOPBACK, "localhost"))
        self._cookie, self._session = f"rotcal_{port}", token_urlsafe()

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """Return the answer to a request that is not let through, or that brings the key."""
        if headers.get("host") not in self._hosts:
            return PlainTextResponse("this page is not served under that host name", 421)
        request = Request(scope)
        if not _same(request.cookies.get(self._cookie, ""), self._session):
            return self._entry(request.query_params.get("key", ""))
        return super()._refusal(scope, headers)

    def _entry(self, key: str) -> Response:
        """Exchange the key for the cookie, once."""
        if not self.key or not _same(key, self.key):
            return PlainTextResponse(
                "this address was used already, or is not whole: end rotcal web and start it anew",
                403,
            )
        self.key = ""
        entered = RedirectResponse("/", 303)
        entered.set_cookie(self._cookie, self._session, httponly=True, samesite="strict")
        return entered


def _same(given: str, expected: str) -> bool:
    return hmac.compare_digest(given.encode(), expected.encode())


def serve(folder: Path, port: int, opened: Callable[[str], object]) -> None:
    """Serve the page until somebody interrupts; ``opened`` is given its address."""
    listening = listening_socket(LOOPBACK, port)
    port = listening.getsockname()[1]
    guard = make_app(folder, port)
    opened(f"http://{LOOPBACK}:{port}/?key={guard.key}")
    server = uvicorn.Server(
        uvicorn.Config(
            guard,
            log_level="warning",
            lifespan="off",
            timeout_graceful_shutdown=CLOSING_S,
            server_header=False,
        )
    )
    with suppress(KeyboardInterrupt):
        server.run([listening])
