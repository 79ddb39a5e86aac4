"""The policy ``until_goal``: fixed sweeps until the uncertainty is as wanted.

With known noise the uncertainty of a set of lengths is known before any is taken: the first sweep
is the set that reaches the goal with the planned noise. What is not known is learnt on the way:

* the noise, as the result of the first sweep states it; further steps are as many as are lacking
  then, where they pay most for their time;
* blocked beams: a step that was given up is replaced by the best at the same station, and beams
  nearby are held to be blocked too until better is known;
* lengths that the solver leaves out are measured again, then all lengths of their station; a
  length that stays suspect is replaced by another target;
* a drift: the first step and the middle step are measured again, to close the sweep;
* the U of the result: while that misses the goal further steps follow.

Where all steps together would miss the goal with the noise as it is, it ends at once: hours of
lengths would lead to nothing.

With known noise the first sweep is all that there is to plan. The fewest steps are found by
exchange; they are then shared among sweeps there and back, so that neither a drift of the machine
nor a knock of the tracer is mistaken for a deviation
(:mod:`rotcal_ros.methods.tracer.policy.sequence`). Further steps are those with the best gain per
second, spread over the stations (:func:`choose_steps`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.language import NOTHING, Phrase, join_texts, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.methods.tracer.policy.exchange import Demands, fewest_lengths
from rotcal_ros.methods.tracer.policy.experiment import (
    Allowance,
    LengthExperiment,
    MeasuredLengths,
    StatedResult,
)
from rotcal_ros.methods.tracer.policy.information import Information, Lengths
from rotcal_ros.methods.tracer.policy.sequence import (
    SequenceForecast,
    least_hidden,
    measuring_orders,
)
from rotcal_ros.planning.choices import PolicyProgress, StepChoice, StepOutcome
from rotcal_ros.planning.sequence_time import constant_time_model

RESERVE: Final = 0.75
"""The first sweep aims so far below the goal: a few lengths more show the noise better, and save
the turns of the table that further sweeps would take."""
RESERVE_PER_SEGMENT: Final = 0.8
"""The same with one zero per segment: fewer unknowns leave more of the noise to be seen."""
NEARLY: Final = 1.02
"""The order of the steps changes what the solver allows for slips by no more."""
DOUBTED: Final = 0.9
"""Share of what is planned that is aimed at next, where a result is not believed yet."""
NOWHERE: Final = PolicyProgress(0)
POOR_CHANCE: Final = 0.5
"""A planned step with a smaller chance gives way to a better one at the same station."""
UNKNOWN: Final = 1e-3
"""A larger uncertainty (rad) is that of a station that nothing has placed yet."""
EXCHANGES: Final = 300
CHECKED_EXCHANGES: Final = 40
"""So long the first sweep is sought by exchange, before anything moves: about a second."""
LEAST_REDUNDANCY: Final = 0.02
"""Redundancy of each length of the first sweep: an error of 33 standard deviations shows."""
HIDDEN: Final = 0.9 * TOLERABLE
"""What a drift or knock may do unseen (std); below the limit, as the noise is not known yet."""
NEARLY_HIDDEN: Final = 0.95 * TOLERABLE
"""No larger set is measured for what is nearly as little."""
SHARES: Final = (1.0, 0.93)
"""Shares of the required uncertainty: some lengths more may need a sweep less to be protected, and
the quicker of the two is taken."""
TRIES: Final = 3
"""Times that a smaller uncertainty is tried, to make room for what the solver allows for slips."""
BLOCKED_WIDTH: Final = 15.0 * DEGREE
"""A beam so near to a blocked one is as likely blocked as free."""
TINY: Final = 1e-6
"""Angle (rad) that stands for none, to divide by."""
FEW_SUSPECTS: Final = 4
SUSPECT_SHARE: Final = 0.1
"""When more lengths than either are suspect, that is no error of single lengths but noise."""
ROUNDS: Final = 6
"""Rounds, about, in which further steps are put together."""
SHORTLIST: Final = 700
"""Only so many of the best candidates are looked at again in every round."""
MOST_PER_STATION: Final = 3
"""No more lengths of a station are taken in one round: they would all be alike."""
MOST_AT_ONCE: Final = 60
"""So many further lengths are planned at once: choosing has to be quick."""
LEAST_GAIN: Final = 5e-4
"""A length that lowers the mean variance by less than this share is not worth its time."""


class UntilGoal:
    """Chooses among the steps of ``experiment`` until the result states the ``goal``.

    That is U, k = 2, rms over the angles, rad.
    ``again``: steps that a resumed plan measures again first; ``earlier`` is what the earlier runs
    observed, ``given_up`` the steps that they gave up. A resumed policy goes through that in the
    order of time, and is then where the earlier ones ended.
    """

    def __init__(
        self,
        experiment: LengthExperiment,
        goal: float,
        *,
        again: Iterable[int] = (),
        earlier: Iterable[Observation] = (),
        given_up: Iterable[int] = (),
    ) -> None:
        self._experiment, self._goal = experiment, goal
        self._measured = experiment.nothing
        self._beams = FreeBeams(experiment.directions)
        self._at: int | None = None
        self.noise_factor = 1.0
        """Noise of the lengths in units of the planned one, as the last result states it."""
        self._now: float | None = None
        """The planned uncertainty (rad) of what is measured, once worked out."""
        self._doubted, self._best = False, math.nan
        """Whether the goal may be out of reach, and what all steps would give (rad), if known."""
        self._seen: dict[tuple[int, int], Observation] = {}
        """The last observation of every run and step: all that the solver will get."""
        self._result: StatedResult | None = None
        """What the result of these states, once it was asked for."""
        self._stop: Phrase | None = None
        """Why nothing more is measured."""
        self._allowance = Allowance()
        self._hopeless = False
        """Whether a result has shown an error motion beyond the goal; a second one is believed."""
        self._suspects = Suspects()
        self._closing = Closing()
        self._queue = deque((step, phrase("first sweep")) for step in self._first_sweep())
        self._plan()
        self._go_through(earlier, set(given_up))
        if self._next().step is not None:  # there is something to be joined
            joining = [
                (step, phrase("completed step, measured again to join the runs")) for step in again
            ]
            self._queue.extendleft(reversed(joining))

    def _go_through(self, earlier: Iterable[Observation], given_up: set[int]) -> None:
        """Follow the earlier runs, whose choices are found again from what they observed."""
        for seen in sorted(earlier, key=lambda o: (o.run, o.window_end_ns, o.attempt)):
            while (step := self._next().step) != seen.step and step in given_up:
                self.note(StepOutcome(step, None))
                given_up.remove(step)
            self.note(StepOutcome(seen.step, seen))
        for step in sorted(given_up):
            self.note(StepOutcome(step, None))

    def _first_sweep(self) -> list[int]:
        """Return the steps of the first sweep, with the reserve where there are enough."""
        goal = self._goal
        reserve = RESERVE_PER_SEGMENT if self._experiment.per_segment else RESERVE
        first = first_sweep(self._experiment, reserve * goal)
        nothing = self._experiment.nothing
        found = self._experiment.uncertainty(nothing, 1.0, first)
        reached = found <= NEARLY * reserve * goal
        return first if reached else first_sweep(self._experiment, goal)

    def choose(self) -> StepChoice:
        """Return the next step, or why nothing more is measured."""
        found = self._next()
        return StepChoice(found.step, found.reason, self._standing())

    def _next(self) -> StepChoice:
        """Return the choice without its standing."""
        if self._stop is not None:
            closed = self._closing.describe()
            why = join_texts([self._stop, closed], "") if closed else self._stop
            return StepChoice(None, why, NOWHERE)
        step, reason = self._queue[0]
        if step not in self._measured and self._beams.clear_probability[step] < POOR_CHANCE:
            step, reason = self._queue[0] = self._better_than(step, reason)
        return StepChoice(step, reason, NOWHERE)

    def note(self, outcome: StepOutcome) -> None:
        """Take notice of a length, or of a step that was given up."""
        step = outcome.step
        queued = next((entry for entry in self._queue if entry[0] == step), None)
        if queued is not None:
            self._queue.remove(queued)
        self._at = int(self._experiment.position[step])
        if outcome.observation is not None:
            self._beams.note_free(step)
            self._closing.note(outcome.observation, self._measured)
            self._measured.add(outcome.observation)
            self._seen[outcome.observation.run, step] = outcome.observation
            self._now = self._result = None
        elif step not in self._measured:
            self._beams.note_blocked(step)
            self._replace(
                step,
                phrase(
                    ("step {0} failed in every attempt: another target is measured instead"), step
                ),
            )
        self._plan()  # now, for choosing has to be quick

    def _plan(self) -> None:
        """Have a step in the queue, or know why nothing more is measured."""
        self._stop = None
        while not self._queue and self._stop is None:
            self._stop = self._plan_further()

    @property
    def _learnt(self) -> Phrase:
        return phrase("noise {0:.3g} times the planned", self.noise_factor)

    def _uncertainty(self) -> float:
        """Return the planned uncertainty (rad) of what is measured, with the noise as stated."""
        if self._now is None:
            self._now = self._experiment.uncertainty(self._measured, self.noise_factor)
        return self._now

    def _solved(self) -> StatedResult:
        """Return what the result states of all that was measured."""
        if self._result is None:
            self._result = self._experiment.solved(tuple(self._seen.values()))
            std = self._result.length_std
            self.noise_factor = self._experiment.noise(self._measured, std)
            self._now, self._best = None, math.nan
        return self._result

    def _standing(self) -> PolicyProgress:
        now = self._uncertainty() if self._result is None else self._result.uncertainty
        known = now if now < UNKNOWN else math.nan
        return PolicyProgress(len(self._queue), known, self._goal)

    def _plan_further(self) -> Phrase | None:
        """Queue what is needed next; or return why nothing is."""
        of, goal = self._experiment, self._goal
        if of.solvable(self._measured):
            result = self._solved()
            if self._close(result) or self._measure_again(result):
                return None
            if (now := result.uncertainty) <= goal:
                return phrase(
                    "goal reached: {0} <= {1}, {2}", _arcsec(now), _arcsec(goal),
                    self._noise_and_doubt
                )  # fmt: skip
            self._allow_for(result)
        if (stop := self._beyond_reach()) is not None:
            return stop
        wish = StepRequirement(self._allowance.planned(goal), self.noise_factor)
        more = choose_steps(
            of, self._measured, self._beams.allowed, self._beams.clear_probability, wish
        )
        if not more:
            lacking = of.describe_lacking(self._measured)
            worse = lacking or phrase(
                "{0} > {1}", _arcsec(self._standing().uncertainty), _arcsec(goal)
            )
            return phrase(
                "no remaining step would reduce U: {0}, {1}", worse, self._noise_and_doubt
            )
        self._doubted = self._doubted or len(more) >= MOST_AT_ONCE
        if (stop := self._beyond_reach()) is not None:
            return stop
        why = phrase("{0}: {1} more lengths to {2}", self._learnt, len(more), _arcsec(goal))
        self._queue += ((step, why) for step in _as_sweep(of, more, self._at))
        return None

    @property
    def _noise_and_doubt(self) -> Phrase:
        """The noise, and why the result is not ok where something is said against it."""
        if self._result is None or not self._result.doubt:
            return self._learnt
        return phrase(
            "{0}; but the verdict would not be ok: {1}", self._learnt, self._result.doubt
        )

    def _allow_for(self, result: StatedResult) -> None:
        """Plan from now on for what the solver states, which is more than what was planned."""
        planned = self._experiment.planned(self._measured, self.noise_factor)
        floor = self._experiment.error_motion_uncertainty(result.error_motion)
        if math.isfinite(result.uncertainty) and floor < self._goal:
            self._allowance = Allowance.of(result.uncertainty, planned, floor)
        elif math.isfinite(result.uncertainty) and self._hopeless:
            self._allowance = Allowance(floor)
        else:  # noise that a first sweep has underestimated looks like error motion, too
            self._hopeless = math.isfinite(result.uncertainty)
            self._allowance = Allowance.of(self._goal / DOUBTED, planned, 0.0)

    def _beyond_reach(self) -> Phrase | None:
        """Return that all steps together miss the goal, if that was doubted and is so."""
        best, goal = self._allowance.floor, self._goal  # which no length lowers
        if self._doubted:
            if math.isnan(self._best):
                left = np.setdiff1d(
                    np.flatnonzero(self._beams.allowed), list(self._measured.steps)
                )
                self._best = self._experiment.planned(self._measured, self.noise_factor, left)
            best = self._allowance.stated(self._best)
        if not goal <= best < math.inf:
            return None
        missed = phrase("all remaining steps would give {0} > {1}", _arcsec(best), _arcsec(goal))
        if self._allowance.floor >= goal:
            missed = phrase(
                "the table's error motion alone, as its circle shows it, gives {0}", _arcsec(best)
            )
        return phrase("the goal is out of reach: {0}, {1}", missed, self._noise_and_doubt)

    def _measure_again(self, result: StatedResult) -> bool:
        """Queue what suspect lengths require: the same again, or other targets."""
        kept = self._measured.observations
        suspects = [each for each in result.suspects if each[0] in kept]
        if not self._suspects.few(suspects, self._measured):
            return False
        for suspect, left_out in suspects:
            again, why = self._suspects.again(suspect, left_out, self._measured)
            self._queue.extend((step, why) for step in again)
            if not again:
                self._measured.drop(suspect)
                self._now = None
                self._beams.allowed[suspect.step] = False
                self._replace(suspect.step, why)
        return bool(self._queue)

    def _close(self, result: StatedResult) -> bool:
        """Queue steps that close a sweep that drifts; False: it does not, or is closed already."""
        if self._closing.begun or not result.drifts:
            return False
        why = phrase("{0}: measured again to close the sweep", result.doubt)
        self._queue.extend((step, why) for step in self._closing.begin(self._measured))
        return True

    def _better_than(self, step: int, reason: Phrase) -> tuple[int, Phrase]:
        """Return a step at the same station with a better chance, or ``step`` itself."""
        found, chance = self._instead(step), self._beams.clear_probability
        if found is None or chance[found] <= chance[step]:
            return step, reason
        return found, phrase(
            "the beam of step {0} is probably blocked: another target is measured instead", step
        )

    def _replace(self, step: int, why: Phrase) -> None:
        found = self._instead(step)
        if found is not None:
            self._queue.appendleft((found, why))

    def _instead(self, step: int) -> int | None:
        queued = [other for other, _ in self._queue]
        place = int(self._experiment.position[step])
        beams = self._beams
        return best_at(
            self._experiment, place, self._measured, queued, beams.allowed,
            beams.clear_probability, self.noise_factor,
        )  # fmt: skip


def _arcsec(uncertainty: float) -> Phrase:
    return phrase(
        "U {0:.3f} arcsec rms", uncertainty / ARCSEC
    )  # the largest U of a curve is another figure


class Closing:
    """The steps that close the sweep, if it drifts, and by how much their lengths have changed."""

    def __init__(self) -> None:
        self._changes: dict[int, float] = {}

    @property
    def begun(self) -> bool:
        """Whether there are such steps: a sweep is closed once."""
        return bool(self._changes)

    def begin(self, measured: MeasuredLengths) -> tuple[int, int]:
        """Return the first and the middle step of what was measured."""
        by_time = [measured.observations[row] for row in measured.time_order().argsort()]
        steps = by_time[0].step, by_time[len(by_time) // 2].step
        self._changes = dict.fromkeys(steps, math.nan)
        return steps

    def note(self, observation: Observation, measured: MeasuredLengths) -> None:
        """Take notice of a length, before it is ``measured``: one that closes is compared."""
        step = observation.step
        if not math.isnan(self._changes.get(step, 0.0)):
            return
        before = measured.last_of(step)
        if before is None or not measured.share_zero(before, observation):
            self._changes[step] = math.inf
        else:
            self._changes[step] = observation.mean[0] - before.mean[0]

    def describe(self) -> Phrase:
        """Return by how much lengths have changed, to end a sentence with; empty: none closed."""
        known = {s: change for s, change in self._changes.items() if not math.isnan(change)}
        if not known:
            return NOTHING
        steps = [phrase("{0} {1}", step, _by(change)) for step, change in known.items()]
        return phrase("; closed: step {0}", join_texts(steps, ", "))


def _by(change: float) -> Phrase:
    """Return a change of a length (m) in words; infinite: the zero is another one."""
    if not math.isfinite(change):
        return phrase("with another zero")
    return phrase("by {0:+.2f} um", change / MICROMETRE)


def first_sweep(of: LengthExperiment, uncertainty: float) -> list[int]:
    """Return the steps that reach ``uncertainty`` (rad) with the planned noise, in their order.

    Takes some seconds, once for each uncertainty.
    """
    if uncertainty not in of.sweeps:
        ways = [_reaching(of, share * uncertainty) for share in SHARES]
        best = min(ways, key=lambda way: (max(way.unseen, NEARLY_HIDDEN), way.seconds))
        of.sweeps[uncertainty] = best.steps
    return list(of.sweeps[uncertainty])


class Sweep(NamedTuple):
    """``steps`` in their order, their time (s), and what drift or knock may do unseen (std)."""

    steps: tuple[int, ...]
    seconds: float
    unseen: float


def _reaching(of: LengthExperiment, uncertainty: float) -> Sweep:
    """Return the fewest steps that reach ``uncertainty`` (rad), in their order."""
    aim = uncertainty
    for _ in range(TRIES):
        steps = _fewest(of, aim)
        found = of.uncertainty(of.nothing, 1.0, steps)
        if not uncertainty < found < np.inf:
            break
        aim *= uncertainty / found
    return drift_proof_sweep(of, steps)


def drift_proof_sweep(of: LengthExperiment, steps: list[int]) -> Sweep:
    """Return ``steps`` in the quickest order that shows drift and knock in time, or most of it."""
    if not of.solvable(of.nothing, steps):
        return Sweep(tuple(_as_sweep(of, steps, None)), np.inf, np.inf)
    rows = np.array(_as_sweep(of, steps, None))
    position, target = of.position[rows], of.target[rows]
    time = constant_time_model(of.costs.turn_s, of.costs.step_s)
    costs = time.costs(of.scene.table_angles, of.scene.targets, position, target)
    forecast = SequenceForecast(of.posed(of.nothing, 1.0, rows))
    # whole sweeps only: what is added later has to find each position early and late alike
    ways = measuring_orders(position, target, costs, forecast, limit=HIDDEN, sparse=())
    best = least_hidden(ways, HIDDEN)
    unseen = np.inf if best.forecast is None else best.forecast.worst
    return Sweep(tuple(rows[best.order].tolist()), best.seconds, unseen)


def _fewest(of: LengthExperiment, uncertainty: float) -> list[int]:
    every = np.ones(len(of.plan.steps), dtype=np.bool_)
    wish = StepRequirement(uncertainty, 1.0)
    steps = choose_steps(of, of.nothing, every, np.ones(len(every)), wish, sweep=True)
    return _exchanged(of, steps, uncertainty)


def _exchanged(of: LengthExperiment, steps: list[int], uncertainty: float) -> list[int]:
    """Return fewer steps that reach as much, all stations being visited anyway.

    The fewest are nearly the same with and without a check, and sooner found without.
    """
    plain = Demands(
        mean=(uncertainty / COVERAGE_FACTOR) ** 2,
        largest=np.inf,
        redundancy=LEAST_REDUNDANCY,
        share=np.inf,
        per_station=of.minimum,
        checked=False,
    )
    every = of.lengths(range(len(of.plan.steps)), of.nothing)
    near = np.flatnonzero(np.isin(every.target, every.target[steps]))
    pool, best = every[near], np.searchsorted(near, np.sort(steps))
    zeros = 1 if of.per_segment else of.stations
    for demands, exchanges in (
        (plain, EXCHANGES),
        (replace(plain, checked=True), CHECKED_EXCHANGES),
    ):
        found = fewest_lengths(of.scene, pool, zeros, demands, best, exchanges=exchanges)
        best = best if found is None else found
    return [int(step) for step in near[best]]


class FreeBeams:
    """Beams along ``directions`` (k, 3), unit vectors; ``allowed`` (k,): not found blocked."""

    def __init__(self, directions: Floats) -> None:
        count = len(directions)
        self._directions = directions
        self.allowed = np.ones(count, dtype=np.bool_)
        self._from_blocked, self._from_free = np.full(count, np.pi), np.full(count, np.pi)
        """Angles (k,) of every beam to the nearest that was blocked, and free, rad."""
        self._free: list[int] = []
        """Beams that were found free, and are not yet in the angles."""

    def note_free(self, number: int) -> None:
        """Note that a beam was free."""
        self._free.append(number)

    def note_blocked(self, number: int) -> None:
        """Note that a beam was blocked: it is not allowed any more."""
        self._from_blocked = np.minimum(self._from_blocked, self._angles_from(number))
        self.allowed[number] = False

    @property
    def clear_probability(self) -> Floats:
        """How probably each beam (k,) is free: less near a blocked one, more near free ones."""
        if not (self._from_blocked < np.pi).any():
            return np.ones(len(self._from_blocked))
        while self._free:
            self._from_free = np.minimum(self._from_free, self._angles_from(self._free.pop()))
        blocked = np.maximum(self._from_blocked, TINY)
        near = 0.5 ** ((blocked / BLOCKED_WIDTH) ** 2)
        return np.asarray(1.0 - near * np.minimum(1.0, self._from_free / blocked))

    def _angles_from(self, number: int) -> Floats:
        cosine = np.clip(self._directions @ self._directions[number], -1.0, 1.0)
        return np.asarray(np.arccos(cosine), dtype=np.float64)


class Suspects:
    """The steps whose lengths were suspect, and how far that has been followed."""

    def __init__(self) -> None:
        self._steps: set[int] = set()
        self._gone_over: set[int] = set()
        """Suspect steps that were measured again, and table positions where all were."""

    def few(self, suspects: Iterable[tuple[Observation, str]], measured: MeasuredLengths) -> bool:
        """Whether so few lengths were suspect that each may be an error of its own."""
        every = self._steps | {suspect.step for suspect, _ in suspects}
        return len(every) <= max(FEW_SUSPECTS, round(SUSPECT_SHARE * len(measured.steps)))

    def again(
        self, suspect: Observation, left_out: str, measured: MeasuredLengths
    ) -> tuple[list[int], Phrase]:
        """Return the steps to measure again, and why: the suspect one, then all of its station.

        Where few lengths check each other a wrong one makes others look wrong. Without any, that
        was in vain, and another target has to take its place. ``left_out``: why it was.
        """
        step, place = suspect.step, suspect.table_position
        why = phrase("the length of step {0} is suspect ({1})", step, left_out)
        if step not in self._steps:
            self._steps.add(step)
            return [step], phrase("{0}: measured again", why)
        here = {o.step for o in measured.observations if o.table_position == place}
        others = sorted(here - self._steps)
        if others and place not in self._gone_over:
            self._gone_over.add(place)
            return others, phrase("{0} again: its whole station is measured again", why)
        return [], phrase("{0} repeatedly: another target is measured instead", why)


@dataclass(frozen=True, slots=True)
class StepRequirement:
    """What a set of steps has to reach: ``uncertainty`` (rad, k = 2) with this noise.

    ``noise`` is a factor on the planned standard deviation of a length.
    """

    uncertainty: float
    noise: float

    def excess(self, known: Information) -> float:
        """Return by which share the mean variance is too large."""
        return float((COVERAGE_FACTOR * known.rms_std / self.uncertainty) ** 2 - 1.0)


def choose_steps(
    of: LengthExperiment,
    measured: MeasuredLengths,
    allowed: Bools,
    chance: Floats,
    wish: StepRequirement,
    *,
    sweep: bool = False,
) -> list[int]:
    """Return further steps that grant the wish, the best gain per time first.

    ``allowed`` (k,): candidates; ``chance`` (k,): how probably the beam is free. ``sweep``:
    all stations are visited anyway, so that a turn of the table costs nothing extra. Stops
    short of the wish when no candidate helps, and where very many are needed.
    """
    chosen: list[int] = []
    free = allowed.copy()
    free[list(measured.steps)] = False
    known = of.information(measured, wish.noise)
    visited = np.full(of.stations, sweep)
    shortlist = _shortlist(of, known, np.flatnonzero(free), measured, chance)
    batch = 0
    while len(shortlist) and (sweep or len(chosen) < MOST_AT_ONCE):
        missing = wish.excess(known)
        lacking = of.stations_lacking_lengths(known.lengths)
        if missing <= 0.0 and not lacking.any():
            break
        batch = 1 if sweep else _batch(of, known, missing, batch)  # at first there is time
        offered = of.lengths(shortlist, measured)
        value = _value(of, known, offered, chance[shortlist], visited)
        if lacking.any():
            value = value * lacking[offered.position]
            batch = len(visited)
        elif not (value > LEAST_GAIN * known.mean_variance / of.costs.longest_step_s).any():
            break
        best = _spread_out(of, shortlist, value, batch)
        if not best:
            break
        chosen += best
        visited[of.position[best]] = True
        shortlist = shortlist[~np.isin(shortlist, best)]
        known = of.information(measured, wish.noise, chosen)
    return chosen


def _batch(of: LengthExperiment, known: Information, missing: float, before: int) -> int:
    """Return how many lengths the next round takes; ``before``: the round before, 0 at first."""
    needed = max(missing, 0.0) * max(len(known.lengths), of.minimum)
    batch = before or max(1, round(needed / ROUNDS))
    return min(batch, MOST_PER_STATION * of.stations, max(1, round(0.5 * needed)))


def best_at(
    of: LengthExperiment,
    position: int | None,
    measured: MeasuredLengths,
    queued: Collection[int],
    allowed: Bools,
    chance: Floats,
    noise: float,
) -> int | None:
    """Return the step with the largest gain beside those ``measured`` and ``queued``.

    ``position``: of the table, None for any. None if there is none.
    """
    done = measured.steps
    further = [step for step in queued if step not in done]
    free = allowed.copy() if position is None else allowed & (of.position == position)
    free[[*done, *further]] = False
    candidates = np.flatnonzero(free)
    if not len(candidates):
        return None
    known = of.information(measured, noise, further)
    gains = known.gains(of.lengths(candidates, measured))
    return int(candidates[np.argmax(gains * chance[candidates])])


def _as_sweep(of: LengthExperiment, steps: Collection[int], at: int | None) -> list[int]:
    """Return ``steps`` station by station, from the end that is nearer to position ``at``."""
    ordered = sorted(steps, key=lambda step: (of.position[step], step))
    if not ordered or at is None:
        return ordered
    first, last = of.position[ordered[0]], of.position[ordered[-1]]
    if abs(last - at) < abs(first - at):
        return sorted(steps, key=lambda step: (-of.position[step], step))
    return ordered


def _shortlist(
    of: LengthExperiment,
    known: Information,
    candidates: Ints,
    measured: MeasuredLengths,
    chance: Floats,
) -> Ints:
    """Return some candidates of each station: the best ones, and some of all directions."""
    if len(candidates) <= SHORTLIST:
        return candidates
    share = SHORTLIST // (2 * of.stations)
    gains = known.gains(of.lengths(candidates, measured)) * chance[candidates]
    kept = []
    for position in np.unique(of.position[candidates]):
        here = np.flatnonzero(of.position[candidates] == position)
        kept.append(here[np.argsort(-gains[here], kind="stable")[:share]])
        kept.append(here[np.linspace(0, len(here) - 1, share).astype(np.int64)])
    return np.asarray(candidates[np.unique(np.concatenate(kept))])


def _value(
    of: LengthExperiment, known: Information, offered: Lengths, chance: Floats, visited: Bools
) -> Floats:
    """Return by how much the mean variance falls per second, (c,)."""
    turn = np.where(visited[offered.position], 0.0, of.costs.turn_s)
    return np.asarray(known.gains(offered) * chance / (of.costs.step_s + turn))


def _spread_out(of: LengthExperiment, candidates: Ints, value: Floats, count: int) -> list[int]:
    """Return up to ``count`` of the best candidates, shared among the stations."""
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > 0.0]
    position = of.position[candidates[order]]
    by_station = np.argsort(position, kind="stable")
    sorted_position = position[by_station]
    rank = np.empty(len(order), dtype=np.int64)
    rank[by_station] = np.arange(len(order)) - np.searchsorted(sorted_position, sorted_position)
    most = -(-count // of.stations)
    best: list[int] = candidates[order[rank < most][:count]].tolist()
    return best
