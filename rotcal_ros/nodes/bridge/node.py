"""The bridge node: writes compensation tables as files, and applies them when a person confirms.

BridgeNode takes tables and looks up corrections. ControllerAccess offers the two services that
change the controller, ``apply`` and ``restore``; ControllerInspector publishes which table is in
force.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from rotcal_msgs import msg
from rotcal_msgs.srv import ApplyTable, GetCorrection, RestoreTable

from rotcal_ros.bags import names
from rotcal_ros.capture import messages
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.export import describe_replacement
from rotcal_ros.compensation.feed import AppliedChange, Feed
from rotcal_ros.compensation.secret import Secret
from rotcal_ros.compensation.table import Correction
from rotcal_ros.foundation.errors import ControllerError, DataError, RotcalError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.in_force import UNKNOWN
from rotcal_ros.foundation.middleware import LOCALHOST
from rotcal_ros.foundation.node_state import NodeState, Reason, State, Why
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.cell_node import CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.qos import LATCHED
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.nodes.runtime.timers_and_subscriptions import steady_timer
from rotcal_ros.planning.settings import CellSettings


class BridgeNode(CellNode):
    """Takes tables and looks up corrections; ControllerAccess talks to the controller."""

    def __init__(self) -> None:
        super().__init__("bridge")

    def configure(self) -> None:
        """Open the controller."""
        settings = self.settings("bridge", BridgeSettings)
        cell = self.settings("cell", CellSettings)
        simulated = "simulation" in self.given
        self._feed = Feed(
            settings,
            cell.axis,
            self.now_ns,
            simulated=simulated,
            serial=self.settings("identity", Identity).serial,
            stated=cell.table_in_force,
        )
        self._correction: Correction | None = None
        self._state = NodeState.of(State.WAITING, Why.NO_TABLE)
        self._own: dict[str, Any] = {"controller": settings.controller, "axis": cell.axis}
        self._facts: dict[str, Any] = {}
        self.listen(msg.CompensationTable, "compensation_table", self._take, LATCHED)
        self.offer(GetCorrection, "get_correction", self._look_up)
        self._access = ControllerAccess(self, self._feed, self._note)

    def begin_stop(self) -> None:
        """Release the controller; what is being written is finished first."""
        self._access.close()

    def _take(self, message: msg.CompensationTable) -> None:
        """Check a table against the configuration and write its files; a bad one is refused."""
        self._correction = None
        self._feed.forget()
        self._facts = {"table_hash": message.table_hash, "verdict": message.verdict}
        try:
            table = conversions.compensation_table(message)
            files = self._feed.take(table, messages.stamp_ns(message.header.stamp))
        except (RotcalError, OSError) as error:
            self._note(State.FAILED, Why.TABLE_REFUSED, error)
            return
        offer = self._feed.offer
        assert offer is not None
        self._correction = Correction(offer.table)
        self._facts |= {
            "confirmation": offer.confirmation,
            "files": ", ".join(map(str, files)),
            "in_force": describe_replacement(offer.table),
            "residual": offer.export.residual.describe(),
            "warnings": "; ".join(offer.export.warnings),
        }
        for warning in offer.export.warnings:
            self.get_logger().warning(warning)
        try:
            self._feed.refuse_simulated()
        except DataError as error:
            self._facts[NEVER] = str(error)
        self._note(State.READY, Why.TABLE_WRITTEN, table.table_hash[:12])

    def _look_up(
        self, request: GetCorrection.Request, response: GetCorrection.Response
    ) -> GetCorrection.Response:
        try:
            if self._correction is None:
                state = self._state.describe()
                raise DataError(f"there is no table to look up the correction in: {state}")
            approach = Approach(request.approach)
            response.correction = float(self._correction(request.angle, approach))
            response.std = float(self._correction.std(request.angle, approach))
            response.table_hash = self._correction.table.table_hash
            response.success = True
        except (RotcalError, ValueError) as error:
            response.message = str(error)
        return response

    def _note(self, state: State, code: Why, *arguments: object) -> None:
        self._state = NodeState.of(state, code, *arguments)
        self.get_logger().info(self._state.describe())

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return self._state, {**self._own, **self._facts, **self._access.facts}


PERIOD_S: Final = 1.0


class ControllerInspector:
    """Inspects the controller in the thread of its other accesses, and publishes what it found.

    After every look ``tell`` gets a sentence on what contradicts that, or None.
    """

    def __init__(
        self,
        node: CellNode,
        feed: Feed,
        worker: ThreadPoolExecutor,
        tell: Callable[[str | None], None],
    ) -> None:
        self._node, self._feed, self._worker, self._tell = node, feed, worker, tell
        self._looking: Future[tuple[str, str | None]] | None = None
        self._publisher = node.create_publisher(msg.TableInForce, names.TABLE_IN_FORCE, LATCHED)
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
                found, contradiction = UNKNOWN, None
            self._tell(contradiction)
            self._publisher.publish(
                conversions.in_force_message(self._feed.axis, found, self._node.now_ns())
            )
        self._looking = self._worker.submit(self._look)

    def _look(self) -> tuple[str, str | None]:
        """Return what is in force, and a sentence on what contradicts that, or None."""
        found = self._feed.in_force()
        return found, self._feed.contradiction(found)


ANSWERS_PER_ACTION: Final = 20
"""Largest number of accesses to the controller in one action; each has its own time limit."""
OPENING_PERIOD_S: Final = 0.5
"""Interval at which a bridge without the controller's lock tries to get it."""
DISCOVERY_S: Final = 2.0
"""How long a new node may take to know what the others offer."""
AWARE_TIMEOUT_S: Final = 10.0
"""How long a call waits at most for this node to catch up after a standstill."""
SERVICES: Final = ("apply", "restore")
APPLYING: Final = Why.TABLE_APPLIED, Why.TABLE_NOT_APPLIED
RESTORING: Final = Why.TABLE_RESTORED, Why.TABLE_NOT_RESTORED
OFFERED: Final = "apply_offered"
"""Value in the bridge's beat: a table may be applied."""
WITHHELD: Final = "apply_withheld"
"""Value in the bridge's beat: why no table may be applied now."""
NEVER: Final = "never"
"""Value in the bridge's beat: why the present table can never be applied."""
UNFINISHED: Final = "unfinished"
CONTRADICTION: Final = "contradiction"


class ControllerAccess:
    """Talks to the controller in a thread of its own, so that the node beats meanwhile.

    The services are there only while this node alone may change the controller: with its lock, a
    secret, and no other node that offers the same. ``facts`` are for the node's report; ``note``
    takes a state, a code and its arguments.
    """

    def __init__(self, node: CellNode, feed: Feed, note: Callable[..., None]) -> None:
        self._node, self._feed, self._note = node, feed, note
        file = feed.settings.secret_file
        self._secret = Secret(Path(file)) if file else None
        self.facts: dict[str, Any] = {}
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="feed")
        self._opened: Future[str | None] | None = None
        self._discovered_s = time.monotonic() + DISCOVERY_S
        self._opening = steady_timer(node, OPENING_PERIOD_S, node.health.guarded(self._open))
        self._open()
        if feed.settings.controller_folder:
            ControllerInspector(
                node, feed, self._worker, partial(self._warn_of, about=CONTRADICTION)
            )

    def close(self) -> None:
        """Release the controller; what is being written is finished first."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._feed.close()

    def _open(self) -> None:
        """Offer to change the controller as soon as no other node may."""
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
        if self.facts.get(WITHHELD) != why:
            self.facts = {WITHHELD: why}
            self._node.get_logger().warning(f"apply and restore are not offered: {why}")

    def _offer(self, unfinished: str | None) -> None:
        self._opening.cancel()
        self.facts = {OFFERED: True}
        self._warn_of(unfinished)
        self._node.offer(ApplyTable, "apply", self._apply)
        self._node.offer(RestoreTable, "restore", self._restore)

    def _offered(self, service: str) -> int:
        """Return how many nodes offer a service of the cell."""
        return self._node.count_services(self._node.resolve_service_name(service))

    def _warn_of(self, text: str | None, about: str = UNFINISHED) -> None:
        """Show the ``text`` on /diagnostics as a concern, or no longer when it is None."""
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
            await self._do(lambda: self._feed.apply(confirmation), response, APPLYING)
            offer = self._feed.offer
            response.confirmation = "" if offer is None else offer.confirmation
        return response

    async def _restore(
        self, request: RestoreTable.Request, response: RestoreTable.Response
    ) -> RestoreTable.Response:
        kept_hash, limit = request.kept_hash, request.max_change_arcsec
        if await self._may(request.secret, response):
            await self._do(lambda: self._feed.restore(kept_hash, limit), response, RESTORING)
            try:
                response.kept_hash = await self._answer(self._feed.next_restore) or ""
            except (RotcalError, OSError) as error:
                response.message += f"; it is not known what can be restored: {error}"
        return response

    async def _may(self, secret: str, response: Any) -> bool:
        """Return whether a request may change the controller; if not, the response says why."""
        assert self._secret is not None
        health = self._node.health
        await wait_for_condition(
            health.is_current, AWARE_TIMEOUT_S
        )  # a calibration may have begun meanwhile
        if not self._secret.is_in(secret):
            response.message = "the request does not carry the secret of bridge.secret_file"
        elif max(map(self._offered, SERVICES)) > 1:
            response.message = (
                "more than one node offers apply and restore here: end the other one"
            )
        elif "planner" in health.present() and health.is_calibrating():
            response.message = (
                "a calibration runs with what the controller holds now: end it first"
            )
        else:
            return True
        self._note(State.READY, Why.REQUEST_REFUSED, response.message)
        return False

    async def _do(
        self, action: Callable[[], AppliedChange], response: Any, codes: tuple[Why, Why]
    ) -> None:
        """Change the table of the controller and put the outcome into the response.

        ``codes`` are those of success and of failure.
        """
        good, bad = codes

        def work() -> AppliedChange:
            try:
                done = action()
            except (RotcalError, OSError) as error:
                self._note(State.FAILED, bad, error)
                raise
            finally:
                with suppress(RotcalError, OSError):  # the outcome counts, not this inspection
                    self._warn_of(self._feed.unfinished())
            self._note(State.READY, good)
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
            f"{Reason(good).describe()}; largest change "
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
                f"not finished within {limit_s:g} s: whether the table will be changed is not "
                "known yet; look at /diagnostics, and wait until it says so"
            ) from error


def main() -> None:
    """Run the bridge, reachable from this machine alone unless the user has set the range."""
    run_node(BridgeNode, LOCALHOST)


if __name__ == "__main__":
    main()
