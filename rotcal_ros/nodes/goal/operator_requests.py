"""Requests to a person or a robot, and waiting for the answer: work of the plan, or a stop."""

from __future__ import annotations

from functools import partial
from typing import Final

from rotcal_ros.nodes.goal.goal_watch import GoalWatch
from rotcal_ros.nodes.runtime.diagnostic_warnings import BLOCKED
from rotcal_ros.planning.plan import PAUSED, RELEASED, STOPPED, Move

REPEAT_PERIOD_S: Final = 2.0
"""An instruction is repeated after this time, for clients that join late."""


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
                text = stop_text(*seen, work)
                pauses.show(text, move)
                watch.tell(PAUSED + text)
                await watch.wait(partial(self._has_changed, seen), REPEAT_PERIOD_S)
            stop.forget()
        finally:
            pauses.end()
            watch.progress.go_on()

    def _has_changed(self, seen: tuple[str, str]) -> bool:
        """Return whether there is an answer, or something else to say than was ``seen``."""
        stop = self._watch.stop
        return not self._watch.pauses.waiting or (stop.why, stop.latched) != seen


def obstacle(watch: GoalWatch) -> str:
    """Return why a goal cannot be resumed yet, in words; empty: it can."""
    health = watch.links.health
    watch.stop.heed()
    stop = [f"the emergency stop is on: {watch.stop.why}"] if watch.stop.why else []
    blocked = [
        f"node {name} waits for a person: {text}"
        for name in sorted(health.present())
        if (text := health.values(name).get(BLOCKED))
    ]
    silent = [f"{t} has been silent for {s:.1f} s" for t, s in watch.silent_streams().items()]
    lasting = "; ".join([*stop, *blocked, *silent])
    return lasting or watch.pauses.stop_between(watch.stop.count)


def stop_text(why: str, latched: str, work: str) -> str:
    """Return what a person reads during a stop ``why``, or once it is over; else the ``work``."""
    if why:
        return (
            f"{STOPPED}{why}; nothing is ordered, and the present step does not count; the "
            "recording goes on and the bag is safe; release the stop, then resume"
        )
    if latched:
        after = f" ({work})" if work else ""
        return (
            f"{RELEASED}, it was: {latched}; nothing moves before a person resumes: make sure "
            f"that the cell may move{after}"
        )
    return work
