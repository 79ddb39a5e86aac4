"""Requests to a person or a robot, and waiting for the answer: work of the plan, or a stop."""

from __future__ import annotations

from functools import partial
from typing import Final

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.node_state import Reason, Why
from rotcal_ros.nodes.goal.goal_watch import GoalWatch
from rotcal_ros.nodes.runtime.diagnostic_warnings import BLOCKED
from rotcal_ros.planning.plan import Move

REPEAT_PERIOD_S: Final = 2.0
"""An instruction is repeated after this time, for clients that join late."""


class NotFreeError(RotcalError):
    """A goal that waits for a person cannot go on yet."""


class OperatorRequests:
    """Pauses the goal of a ``watch``, which is a run of a plan."""

    def __init__(self, watch: GoalWatch, plan_id: str, run: int) -> None:
        self._watch, self._plan_id, self._run = watch, plan_id, run

    async def have_done(self, work: str = "", move: Move | None = None) -> None:
        """Show what is to be done before the present step until it is, as long as it takes.

        An emergency stop may come in between; without ``work`` it is all that is waited for.
        """
        watch, pauses, stop = self._watch, self._watch.pauses, self._watch.stop
        watch.progress.pause()
        pauses.begin(self._plan_id, self._run, watch.progress.step, stop.count)
        try:
            while pauses.waiting:
                seen = stop.why, stop.latched
                asked = request(*seen, work)
                pauses.show(asked, move)
                watch.tell_again(asked)
                await watch.wait(partial(self._has_changed, seen), REPEAT_PERIOD_S)
            stop.forget()
        finally:
            pauses.end()
            watch.progress.go_on()

    def _has_changed(self, seen: tuple[str, str]) -> bool:
        """Return whether there is an answer, or something else to say than was ``seen``."""
        stop = self._watch.stop
        return not self._watch.pauses.waiting or (stop.why, stop.latched) != seen


def require_free(watch: GoalWatch) -> None:
    """Raise NotFreeError where a goal cannot be resumed yet."""
    health = watch.links.health
    watch.stop.heed()
    stop = [f"the emergency stop is on: {watch.stop.why}"] if watch.stop.why else []
    blocked = [
        f"node {name} waits for a person: {text}"
        for name in sorted(health.present())
        if (text := health.values(name).get(BLOCKED))
    ]
    silent = [f"{t} has been silent for {s:.1f} s" for t, s in watch.silent_streams().items()]
    if lasting := [*stop, *blocked, *silent]:
        raise NotFreeError("; ".join(lasting))
    if watch.pauses.stop_between(watch.stop.count):
        raise NotFreeError("an emergency stop came in between: look, then resume again")


def request(why: str, latched: str, work: str) -> Reason:
    """Return what is asked of a person during a stop ``why``, once it is over, or as ``work``."""
    if why:
        return Reason.of(Why.STOPPED, why)
    if latched and work:
        return Reason.of(Why.RELEASED_AND_WORK, latched, work)
    return Reason.of(Why.RELEASED, latched) if latched else Reason.of(Why.WORK, work)
