"""A plan that was interrupted is continued in another run of the same session.

Every run numbers its attempts from ``run * ATTEMPTS_PER_RUN`` on: a late answer to an order of an
earlier run is never taken for a new one.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import takewhile

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.untrusted import load_json
from rotcal_ros.planning.plan import Plan


@dataclass(frozen=True)
class Continuation:
    """What is left of an interrupted plan.

    ``steps`` are measured in this order: first those that join the runs (``again``), then
    those that are missing. ``start_index`` is the first missing one. ``observations`` are the
    accepted ones of the earlier runs.
    """

    plan_id: str
    run: int
    start_index: int
    again: tuple[int, ...]
    steps: tuple[int, ...]
    observations: tuple[Observation, ...]

    @property
    def done(self) -> frozenset[int]:
        """The steps that earlier runs have measured."""
        return frozenset(observation.step for observation in self.observations)

    def to_json(self) -> str:
        """Return the text of the continuation file; every float round-trips to the last bit."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Continuation:
        """Read the text of :meth:`to_json`; raises DataError when it is something else."""
        try:
            return record(cls, load_json(text, finite=False))
        except ValueError as error:
            raise DataError(f"not a continuation of an interrupted plan: {error}") from error


@dataclass(frozen=True)
class Recorded:
    """What the recorder has of a session: all observations, in their order, and the run now."""

    plan_id: str
    run: int
    observations: tuple[Observation, ...]

    def to_json(self) -> str:
        """Return a text of it; every float round-trips to the last bit."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Recorded:
        """Read the text of :meth:`to_json`; raises DataError when it is something else."""
        try:
            return record(cls, load_json(text, finite=False))
        except ValueError as error:
            raise DataError(f"not what a recorder reports of its session: {error}") from error


def continued(
    plan: Plan,
    plan_id: str,
    run: int,
    observations: Sequence[Observation],
    *,
    max_attempts: int,
    join_steps: int,
    max_failed_steps: int = 0,
    from_step: int = 0,
) -> Continuation:
    """Return how run number ``run`` goes on after what the earlier runs observed.

    A step is done when it has an accepted observation or was given up after ``max_attempts`` in
    one run. Where ``max_failed_steps`` or more failed running at the end, the planner gave up, not
    those steps. Up to ``join_steps`` done steps are measured again, evenly spread over those at
    table angles that have missing steps; with none there, over all. An instrument that has left a
    station does not go back for that. A turn that is not whole is made again from its begin. What
    is missing before ``from_step`` stays so.
    """
    accepted = {o.step for o in observations if o.accepted}
    rejected = Counter((o.step, o.run) for o in observations if not o.accepted)
    given_up = {step for (step, _), count in rejected.items() if count >= max_attempts}
    in_vain = {o.step for o in takewhile(lambda o: not o.accepted, reversed(observations))}
    if 0 < max_failed_steps <= len(in_vain):
        given_up -= in_vain
    missing = [s.index for s in plan.steps if s.index not in accepted | given_up]
    missing = [index for index in missing if index >= from_step]
    again = _spread(_joining(plan, accepted, missing), join_steps) if missing else ()
    steps = (*again, *missing)
    if turned := _whole_turns(plan, missing):
        steps = tuple(sorted({*missing, *turned}))
        again = tuple(index for index in steps if index not in missing)
    return Continuation(
        plan_id=plan_id,
        run=run,
        start_index=missing[0] if missing else len(plan.steps),
        again=again,
        steps=steps,
        observations=tuple(o for o in observations if o.accepted),
    )


def _whole_turns(plan: Plan, missing: Sequence[int]) -> set[int]:
    """Return the steps with which turns that are not whole begin: at rest, at their target.

    Whatever has happened in between, the reflector then stands there. Where nothing stands at the
    begin of a turn, the probe goes along, and there are none.
    """
    found = set[int]()
    for index in missing:
        step, begin = plan.steps[index], index
        place = step.station, step.target
        while begin and (plan.steps[begin - 1].station, plan.steps[begin - 1].target) == place:
            begin -= 1
        if step.turn is not None and plan.steps[begin].turn is None:
            found.update(range(begin, index))
    return found


def _joining(plan: Plan, accepted: set[int], missing: Sequence[int]) -> Sequence[int]:
    """Return the done steps from which those that join the runs are chosen."""
    opened = {(plan.steps[k].station, plan.steps[k].table_position) for k in missing}
    stations = {station for station, _ in opened}
    here = [plan.steps[k] for k in sorted(accepted) if plan.steps[k].station in stations]
    at_open_angles = [step for step in here if (step.station, step.table_position) in opened]
    return [step.index for step in at_open_angles or here]


def _spread(values: Sequence[int], count: int) -> tuple[int, ...]:
    """Return ``count`` of the values, evenly spread, both ends among them."""
    if len(values) <= count:
        return tuple(values)
    if count == 1:
        return (values[-1],)
    places = (round(k * (len(values) - 1) / (count - 1)) for k in range(count))
    return tuple(values[place] for place in places)
