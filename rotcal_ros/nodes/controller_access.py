"""The services that change a controller: who may call them, when, and a true answer always."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from rotcal_msgs.msg import TableInForce
from rotcal_msgs.srv import ApplyTable, RestoreTable

from rotcal_ros.bags import names
from rotcal_ros.compensation.feed import Applied, Feed
from rotcal_ros.compensation.secret import Secret
from rotcal_ros.errors import ControllerError, DataError, RotcalError
from rotcal_ros.in_force import UNKNOWN
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode, until
from rotcal_ros.nodes.health import CALIBRATING
from rotcal_ros.nodes.qos import LATCHED
from rotcal_ros.nodes.steady import steady_timer
from rotcal_ros.units import ARCSEC

PERIOD_S: Final = 1.0


class Announcer:
    """Looks at the controller in the thread of its other accesses, and publishes what it found.

    ``tell`` is given in words what contradicts that, after every look; empty when nothing does.
    """

    def __init__(
        self,
        node: CellNode,
        feed: Feed,
        worker: ThreadPoolExecutor,
        tell: Callable[[str], None],
    ) -> None:
        self._node, self._feed, self._worker, self._tell = node, feed, worker, tell
        self._looking: Future[tuple[str, str]] | None = None
        self._publisher = node.create_publisher(TableInForce, names.TABLE_IN_FORCE, LATCHED)
        node.every(PERIOD_S, self._announce)

    def _announce(self) -> None:
        """Publish what the last look found, and look again."""
        looked = self._looking
        if looked is not None and not looked.done():
            return
        if looked is not None:
            try:
                found, contradiction = looked.result()
            except (RotcalError, OSError):
                found, contradiction = UNKNOWN, ""
            self._tell(contradiction)
            self._publisher.publish(
                conversions.in_force_message(self._feed.axis, found, self._node.now_ns())
            )
        self._looking = self._worker.submit(self._look)

    def _look(self) -> tuple[str, str]:
        """Return what is in force, and in words what contradicts that."""
        found = self._feed.in_force()
        return found, self._feed.contradiction(found)


ANSWERS_PER_ACTION: Final = 20
"""Accesses to the controller in one action at most; each has its own time limit."""
OPENING_PERIOD_S: Final = 0.5
"""How often a bridge without the controller's lock tries to get it."""
DISCOVERY_S: Final = 2.0
"""How long a new node may not know yet what the others offer."""
AWARE_TIMEOUT_S: Final = 10.0
"""How long a call waits at most until this node knows what it missed while it stood still."""
SERVICES: Final = ("apply", "restore")
UNFINISHED: Final = "unfinished"
CONTRADICTION: Final = "contradiction"


class ControllerAccess:
    """Talks to the controller in a thread of its own, so that the node beats meanwhile.

    The services are there only while this node alone may change the controller: with its lock, a
    secret, and no other node that offers the same. ``facts`` are for the node's report.
    """

    def __init__(self, node: CellNode, feed: Feed, note: Callable[[str], None]) -> None:
        self._node, self._feed, self._note = node, feed, note
        file = feed.settings.secret_file
        self._secret = Secret(Path(file)) if file else None
        self.facts: dict[str, Any] = {}
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="feed")
        self._opened: Future[str] | None = None
        self._discovered_s = time.monotonic() + DISCOVERY_S
        self._opening = steady_timer(node, OPENING_PERIOD_S, node.health.guarded(self._open))
        self._open()
        if feed.settings.controller_folder:
            Announcer(node, feed, self._worker, partial(self._warn_of, about=CONTRADICTION))

    def close(self) -> None:
        """Leave the controller to others; what is being written is finished first."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._feed.close()

    def _open(self) -> None:
        """Offer to change the controller as soon as nobody else may."""
        settings = self._feed.settings
        if not settings.controller_folder or self._secret is None:
            missing = "secret_file" if settings.controller_folder else "controller_folder"
            self._offer_nothing(f"bridge.{missing} is empty")
            self._opening.cancel()
        elif self._opened is None:
            self._opened = self._worker.submit(self._feed.open)
        elif self._opened.done() and time.monotonic() > self._discovered_s:
            opened, self._opened = self._opened, None
            try:
                unfinished = opened.result()
                if others := [name for name in SERVICES if self._offered(name)]:
                    raise DataError(f"another node offers {' and '.join(others)} here: end it")
            except (RotcalError, OSError) as error:
                self._offer_nothing(str(error))
                return
            self._offer(unfinished)

    def _offer_nothing(self, why: str) -> None:
        if self.facts.get("apply") != (text := f"not offered: {why}"):
            self.facts = {"apply": text}
            self._node.get_logger().warning(f"apply and restore are {text}")

    def _offer(self, unfinished: str) -> None:
        self._opening.cancel()
        self.facts = {"apply": "offered"}
        self._warn_of(unfinished)
        self._node.offer(ApplyTable, "apply", self._apply)
        self._node.offer(RestoreTable, "restore", self._restore)

    def _offered(self, service: str) -> int:
        """Return how many nodes offer a service of the cell."""
        return self._node.count_services(self._node.resolve_service_name(service))

    def _warn_of(self, text: str, about: str = UNFINISHED) -> None:
        """Show the ``text`` on /diagnostics as a concern, or no longer when it is empty."""
        concerns = self._node.health.concerns
        if text and concerns.get(about) != text:
            self._node.get_logger().warning(text)
        others = {name: concern for name, concern in concerns.items() if name != about}
        self._node.health.concerns = {**others, about: text} if text else others

    async def _apply(
        self, request: ApplyTable.Request, response: ApplyTable.Response
    ) -> ApplyTable.Response:
        confirmation = request.confirmation
        if await self._may(request.secret, response):
            await self._do(lambda: self._feed.apply(confirmation), response, "table", "applied")
            offer = self._feed.offer
            response.confirmation = "" if offer is None else offer.confirmation
        return response

    async def _restore(
        self, request: RestoreTable.Request, response: RestoreTable.Response
    ) -> RestoreTable.Response:
        kept_hash, limit = request.kept_hash, request.max_change_arcsec
        if await self._may(request.secret, response):
            await self._do(
                lambda: self._feed.restore(kept_hash, limit), response, "old table", "restored"
            )
            try:
                response.kept_hash = await self._answer(self._feed.next_restore)
            except (RotcalError, OSError) as error:
                response.message += f"; what can be restored is not known: {error}"
        return response

    async def _may(self, secret: str, response: Any) -> bool:
        """Return whether a request may change the controller; else the response says why not."""
        assert self._secret is not None
        health = self._node.health
        await until(health.aware, AWARE_TIMEOUT_S)  # a calibration may have begun meanwhile
        if not self._secret.is_in(secret):
            response.message = "the request does not carry the secret of bridge.secret_file"
        elif max(map(self._offered, SERVICES)) > 1:
            response.message = (
                "more than one node offers apply and restore here: end the other one"
            )
        elif "planner" in health.present() and health.state("planner").startswith(CALIBRATING):
            response.message = (
                "a calibration runs with what the controller holds now: end it first"
            )
        else:
            return True
        self._note(f"request refused: {response.message}")
        return False

    async def _do(self, action: Callable[[], Applied], response: Any, what: str, end: str) -> None:
        """Change the table of the controller and say in the response what came of it."""

        def work() -> Applied:
            try:
                done = action()
            except (RotcalError, OSError) as error:
                self._note(f"{what} not {end}: {error}")
                raise
            finally:
                with suppress(RotcalError, OSError):  # the outcome counts, not this look at it
                    self._warn_of(self._feed.unfinished())
            self._note(f"{what} {end}, read back and equal")
            return done

        try:
            done = await self._answer(work)
        except (RotcalError, OSError) as error:
            response.message = str(error)
            return
        self.facts["backup"] = str(done.backup)
        response.files = list(done.files)
        response.backup, response.largest_change = str(done.backup), done.largest_change
        response.success = True
        before = f"; before this, {done.unfinished}" if done.unfinished else ""
        response.message = (
            f"{what} {end}, read back and equal; largest change "
            f"{done.largest_change / ARCSEC:.4g} arcsec; most controllers use it from their next "
            f"start on{before}"
        )

    async def _answer(self, work: Callable[[], Any]) -> Any:
        """Return what ``work`` on the controller returns."""
        limit_s = ANSWERS_PER_ACTION * self._feed.settings.answer_timeout_s
        try:
            return await self._node.answer_of(self._worker.submit(work), limit_s)
        except FutureTimeout as error:
            raise ControllerError(
                f"no end within {limit_s:g} s: it is not known whether the table will be changed; "
                "/diagnostics tells when it is"
            ) from error
