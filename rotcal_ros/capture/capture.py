"""The capture: records of all streams in, observations out.

Answers of the machine are compared with the orders: one that does not echo its order is reported
at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import asdict
from math import dist, isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.capture.air import QUANTITIES, AirSample, AirStreams
from rotcal_ros.capture.attempt import (
    Attempt,
    AttemptRejectedError,
    AttemptStreams,
    CaptureRules,
    Wait,
    nanoseconds,
    seconds,
)
from rotcal_ros.capture.decisions import single_shot_missing
from rotcal_ros.capture.passage import why_not_turning
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import NEVER, Stream, StreamCounts
from rotcal_ros.capture.table import (
    VELOCITY,
    arrival,
    lasting_feedback_fault,
    why_not_at_rest,
)
from rotcal_ros.capture.window import Beam, TracerStream
from rotcal_ros.foundation.arrays import Stamps
from rotcal_ros.foundation.language import NOTHING, Phrase, phrase
from rotcal_ros.foundation.observations import (
    Command,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.planning.plan import Plan, Step

Record = Command | TracerSample | TableSample | ProbeSample | AirSample
Observations = tuple[Observation, ...]

_MAX_PENDING = 64
_SETTLED_NS: Final = 1_000_000_000
"""Samples stamped less than this after a clock was set back are not used: the other streams may
follow later."""
_PATIENCE_NS: Final = 3_000_000_000
"""A table that is not at rest this long after the probe is in position is reported; a nest that
reads all the time may go on to name the order before for this long."""
_NEAR_M: Final = 1e-6
"""Points closer than this are the same place, however small their stated deviations are."""
_WORDS: Final = {
    "tracer": "tracer readings", "table": "table feedbacks", "nest": "readings beside the table"
}  # fmt: skip
"""What messages call the samples of a stream; those of the air are called after it."""


class Capture:
    """Turns the streams of one calibration into observations, one per attempt at a step.

    An attempt begins with the probe sample that echoes (step, attempt): the machine says that
    the probe stands at its target. It is decided as soon as the streams have delivered everything
    that the decision needs, in whatever order they arrive; attempts come out in the order of their
    probe samples. As long as no stream arrives more than ``clock_tolerance_s`` (machine time)
    behind another, equal streams give equal observations to the last bit. A stream that falls
    further behind rejects the attempt: it is silent, or stamped by another clock. When a clock is
    set back, undecided attempts are rejected and everything before is forgotten.

    ``rules`` are those of the method; ``run`` is the number of the run that is captured, whose
    attempts count from ``first_attempt``: what a nest still sends for earlier ones begins none;
    ``required_air`` names the air quantities without which an observation is useless; with
    ``single_shot`` the tracer measures only on request. It does not matter how long before the
    first attempt the capture began to listen. Commands are only compared with the plan: what
    counts is what the machine did.
    """

    def __init__(
        self,
        plan: Plan,
        settings: CaptureSettings,
        rules: CaptureRules,
        run: int = 0,
        required_air: Collection[str] = (),
        *,
        single_shot: bool = False,
        first_attempt: int = 0,
    ) -> None:
        tolerance = nanoseconds(settings.clock_tolerance_s)
        self._plan, self._settings, self._rules, self._run = plan, settings, rules, run
        self._required = [q for q in QUANTITIES.values() if q.name in required_air]
        self._streams = AttemptStreams(
            tracer=TracerStream(
                tolerance,
                settings.max_length_m,
                Beam(settings.max_silence_s, settings.max_length_speed_m_s),
                single_shot=single_shot,
            ),
            table=Stream(2, tolerance),
            nest=Stream(4, tolerance),
            air=AirStreams(tolerance),
        )
        self._tolerance_ns = tolerance
        self._commands, self._probe = StreamCounts(), StreamCounts()
        self._answers = OrderAnswers()
        self._probe_stamp: int | None = None
        self._stood: ProbeSample | None = None  # since when, by positions that were sent unasked
        self._unasked_ns = 0
        self._set_backs = 0
        self._next_attempt = [first_attempt if step.turn is not None else 0 for step in plan.steps]
        self._pending: deque[Attempt] = deque()
        self._newest: Attempt | None = None
        self._had_velocity = False
        self._waiting: Wait | None = None
        self._checks = rules.checks(plan)
        self._remarks: deque[str] = deque(maxlen=100)
        self._takers: dict[type[Any], Callable[[Any], Observations]] = {
            TracerSample: self._take_tracer,
            TableSample: self._take_table,
            ProbeSample: self._take_probe,
            **dict.fromkeys(QUANTITIES, self._take_air),
            Command: self._take_command,
        }

    def feed(self, record: Record) -> Observations:
        """Take one record; return the observations that it completes, usually none."""
        return self._takers[type(record)](record)

    def feed_tracer(
        self, stamp_ns: Stamps, sequence: NDArray[Any], length: NDArray[Any], status: NDArray[Any]
    ) -> Observations:
        """Take many tracer readings at once, all arrays (n,); same result as one by one."""
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        due = self._streams.tracer.stage_many(stamps, (sequence, length, status))
        return self._decide() if due else ()

    def feed_table(
        self, stamp_ns: Stamps, angle: NDArray[Any], velocity: NDArray[Any]
    ) -> Observations:
        """Take many table feedbacks at once, all arrays (n,); same result as one by one."""
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        due = self._streams.table.stage_many(stamps, (angle, velocity))
        return self._decide() if due else ()

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """What each stream delivered and what was wrong with it, without zeros."""
        all_counts = {}
        unasked = {q.name for q in QUANTITIES.values() if not q.expected(self._settings)}
        unasked.add("nest")
        for name, stream in self._streams.by_name().items():
            stream.flush()
            if stream.counts.received or name not in unasked:
                all_counts[name] = stream.counts
        all_counts |= {"probe": self._probe, "command": self._commands}
        return {
            name: {key: n for key, n in asdict(counts).items() if n or key == "received"}
            for name, counts in all_counts.items()
        }

    @property
    def waiting_for(self) -> str | None:
        """What the oldest undecided attempt waits for, in words."""
        if not self._pending or self._waiting is None:
            return self._answers.unanswered_order()
        attempt, wait = self._pending[0], self._waiting
        lag_s = seconds(self._streams.lag_ns(attempt, wait))
        return (
            f"{attempt.step.describe(attempt.number)}: waiting for "
            f"{self._name(wait.stream)}, now {lag_s:.3g} s behind the other streams"
        )

    @property
    def readings(self) -> int:
        """How many tracer readings have come."""
        return self._streams.tracer.received

    @property
    def asks_for_length(self) -> bool:
        """Whether an instrument that measures on request may do so now: the table has settled."""
        if not self._pending or self._waiting is None:
            return False
        tracer, table = self._streams.tracer, self._streams.table
        return self._waiting.stream is tracer and table.newest_ns >= self._waiting.stamp_ns

    def current_fault(self) -> str | None:
        """Return what keeps the latest order from being measured, well before it is given up."""
        if (wrong := self._answers.current_fault()) or not self._pending:
            return wrong or self._no_answer()
        attempt, table = self._pending[-1], self._streams.table
        if attempt.step.turn is not None:
            fault = why_not_turning(table, attempt, _PATIENCE_NS)
            return fault and f"{attempt.step.describe(attempt.number)}: {fault}"
        reached_ns = self._streams.reached(table, attempt)
        if reached_ns - attempt.begin_ns < _PATIENCE_NS or attempt.search_ns <= reached_ns:
            return None
        step = attempt.step
        reason = why_not_at_rest(
            table, attempt.begin_ns, reached_ns, step.table_angle, self._settings
        )
        return f"{step.describe(attempt.number)}: {reason}"

    def _no_answer(self) -> str | None:
        """Return that table and probe stand still, and nobody answers the latest order."""
        step, table, stood = self._answers.open_step, self._streams.table, self._stood
        if step is None or stood is None or self._plan.steps[step].kind == PointKind.READING:
            return None
        place, since_ns = self._plan.steps[step], self._answers.ordered_ns
        if since_ns is None or table.latest is None:
            return None
        rests_ns = arrival(table, since_ns, place.table_angle, self._settings)
        if rests_ns is None or self._unasked_ns - max(rests_ns, stood.stamp_ns) < _PATIENCE_NS:
            return None
        off = dist(stood.position, place.position)
        return (
            f"{self._answers.unanswered_order()}; table and probe stand still, the probe "
            f"{off:.3g} m from where it was sent"
        )

    def why_unmeasurable(self) -> str | None:
        """Return why no attempt will ever be accepted, with what to change, if that is certain."""
        if (newest := self._newest) is None or newest.step.turn is not None:
            return None
        table = self._streams.table
        self._had_velocity |= bool(np.isfinite(table.values[:, VELOCITY]).any())
        fault = lasting_feedback_fault(
            table, newest.begin_ns, newest.step.table_angle, self._had_velocity,
            self._answers.ordered_ns,
        )  # fmt: skip
        return fault and f"{newest.step.describe(newest.number)}: {fault}"

    def remarks(self) -> tuple[str, ...]:
        """Return and forget what was wrong with records that belong to no observation."""
        texts = tuple(self._remarks)
        self._remarks.clear()
        return texts

    def _take_tracer(self, sample: TracerSample) -> Observations:
        values = (sample.sequence, sample.length, sample.status)
        due = self._streams.tracer.stage(sample.stamp_ns, values)
        return self._decide() if due else ()

    def _take_table(self, sample: TableSample) -> Observations:
        due = self._streams.table.stage(sample.stamp_ns, (sample.angle, sample.velocity))
        return self._decide() if due else ()

    def _take_air(self, sample: AirSample) -> Observations:
        return self._decide() if self._streams.air.stage(sample) else ()

    def _take_command(self, command: Command) -> Observations:
        self._commands.received += 1
        if not 0 <= command.step < len(self._plan.steps):
            self._commands.unknown_step += 1
            self._remarks.append(f"a command for {self._not_in_plan(command.step)}")
            return ()
        for stream in self._streams.fast:
            stream.flush()
        came = [s.latest for s in self._streams.fast if s.latest is not None]
        self._answers.order(command, max(came, default=None))
        self._commands.unanswered = self._answers.unanswered
        step = self._plan.steps[command.step]
        if command != (planned := step.command(command.attempt)):
            self._commands.off_plan += 1
            self._remarks.append(
                f"the command for step {command.step} is not the plan's: found {command}, "
                f"expected {planned}"
            )
        return ()

    def _take_probe(self, sample: ProbeSample) -> Observations:
        """Start an attempt, or add a point to the newest one."""
        self._probe.received += 1
        self._answers.receive(sample)
        if self._goes_on(sample):
            return self._take_reading(sample)
        if sample.kind == PointKind.UNKNOWN:  # a position sent unasked: no attempt begins
            near, self._unasked_ns = self._settings.probe_tolerance_m, sample.stamp_ns
            if self._stood is None or dist(sample.position, self._stood.position) > near:
                self._stood = sample
            return ()
        self._admit()
        newest = self._pending[-1] if self._pending else None
        if not 0 <= sample.step < len(self._plan.steps):
            self._probe.unknown_step += 1
            self._remarks.append(f"a probe sample for {self._not_in_plan(sample.step)}")
        elif newest and (newest.step.index, newest.number) == (sample.step, sample.attempt):
            self._add_point(newest, sample)
        elif sample.attempt < self._next_attempt[sample.step]:
            self._count_again(self._newest, sample)
        else:
            self._begin(sample, newest)
        if not self._streams.before_set_back(sample.stamp_ns):
            self._probe_stamp = sample.stamp_ns
        return self._decide()

    def _goes_on(self, sample: ProbeSample) -> bool:
        """Return whether a point is one of many while the table turns, and begins no attempt."""
        if sample.kind == PointKind.UNKNOWN or not 0 <= sample.step < len(self._plan.steps):
            return False
        step, newest = self._plan.steps[sample.step], self._newest
        if step.turn is None or step.kind != PointKind.READING:
            return False
        if sample.attempt < self._next_attempt[sample.step]:
            return True
        if newest is None or newest.number != sample.attempt:
            return False
        return sample.step in self._plan.passed_from(newest.step.index)

    def _take_reading(self, sample: ProbeSample) -> Observations:
        """Take a point that is read while the table turns."""
        if not self._streams.before_set_back(sample.stamp_ns):
            self._probe_stamp = sample.stamp_ns
        due = self._streams.nest.stage(sample.stamp_ns, _reading(sample))
        return self._decide() if due else ()

    def _begin(self, sample: ProbeSample, newest: Attempt | None) -> None:
        step = self._plan.steps[sample.step]
        self._streams.begin(sample.stamp_ns)
        self._next_attempt[sample.step] = sample.attempt + 1
        if newest is not None and newest.superseded_ns is None:
            newest.superseded_ns = sample.stamp_ns
        attempt = Attempt(step, sample.attempt, self._run, [sample], sample.stamp_ns)
        self._check_sample(attempt, sample)
        if step.turn is not None and step.kind == PointKind.READING:
            self._streams.nest.stage(sample.stamp_ns, _reading(sample))
        self._pending.append(attempt)
        self._newest = attempt

    def _add_point(self, attempt: Attempt, sample: ProbeSample) -> None:
        seen = {earlier.point for earlier in attempt.samples}
        if sample.point in seen or len(seen) >= attempt.step.n_points:
            self._count_again(attempt, sample)
            return
        if attempt.rejected is None:
            self._check_sample(attempt, sample)
        attempt.samples.append(sample)

    def _count_again(self, newest: Attempt | None, sample: ProbeSample) -> None:
        """Count a further point that answers an order, and whether it contradicts the first."""
        self._probe.duplicates += 1
        if newest and (newest.step.index, newest.number) == (sample.step, sample.attempt):
            same = (earlier for earlier in newest.samples if earlier.point == sample.point)
            self._probe.contradicting += any(_elsewhere(earlier, sample) for earlier in same)

    def _check_sample(self, attempt: Attempt, sample: ProbeSample) -> None:
        """Reject an attempt whose probe sample cannot be right."""
        try:
            self._refuse_wrong_stamp(sample)
            self._refuse_off_plan(attempt.step, sample)
        except AttemptRejectedError as error:
            attempt.rejected = error

    def _refuse_wrong_stamp(self, sample: ProbeSample) -> None:
        if self._streams.before_set_back(sample.stamp_ns):
            raise AttemptRejectedError("started before a clock was set back")
        if self._probe_stamp is not None and sample.stamp_ns <= self._probe_stamp:
            self._probe.backwards += 1
            back = seconds(self._probe_stamp - sample.stamp_ns)
            raise AttemptRejectedError(
                "probe stamps go backwards: {0:.3g} s before the previous sample", back
            )
        fast = (stream.latest for stream in self._streams.fast)
        behind_ns = max((at for at in fast if at is not None), default=0) - sample.stamp_ns
        allowed_s = self._settings.clock_tolerance_s + self._settings.step_timeout_s
        if behind_ns > nanoseconds(allowed_s):
            self._probe.backwards += 1
            raise AttemptRejectedError(
                "the probe is stamped {0:.3g} s behind the other streams, allowed {1:g} s: "
                "another clock, or one of them was set", seconds(behind_ns), allowed_s
            )  # fmt: skip

    def _refuse_off_plan(self, step: Step, sample: ProbeSample) -> None:
        if not all(map(isfinite, sample.position)):
            self._probe.non_finite += 1
            raise AttemptRejectedError("probe position is not finite: {0}", sample.position)
        if (sample.kind, sample.target) != (step.kind, step.target):
            self._probe.off_plan += 1
            raise AttemptRejectedError(
                "probe reports {0} at target {1}, the plan says {2} at target {3}",
                sample.kind.name, sample.target, step.kind.name, step.target
            )  # fmt: skip
        if sample.station != step.station:
            self._probe.off_plan += 1
            raise AttemptRejectedError(
                "probe reports station {0}, the plan says station {1}", sample.station,
                step.station
            )  # fmt: skip
        away = dist(sample.position, step.position)
        if step.kind == PointKind.REFLECTOR and away > self._settings.probe_tolerance_m:
            self._probe.implausible += 1
            raise AttemptRejectedError(
                "probe is {0:.6g} m from target {1}: reported {2}, planned {3}, allowed {4:g} m",
                away, step.target, sample.position, step.position, self._settings.probe_tolerance_m
            )  # fmt: skip

    def _decide(self) -> Observations:
        """Admit what is staged and decide as many attempts as possible, the oldest first."""
        self._admit()
        decided: list[Observation] = []
        while self._pending:
            outcome = self._outcome(self._pending[0])
            if isinstance(outcome, Wait):
                self._sleep(self._pending[0], outcome)
                break
            if not self._goes_further(self._pending.popleft(), outcome):
                continue
            for check in self._checks:
                outcome = check(outcome)
            decided.append(outcome)
        return tuple(decided)

    def _goes_further(self, attempt: Attempt, outcome: Observation) -> bool:
        """Let the next step of a turn follow; return False for one broken off before a step."""
        if isfinite(outcome.table_angle_measured):
            if (following := attempt.next_in_turn(self._plan)) is not None:
                self._pending.appendleft(following)
                index = following.step.index
                self._next_attempt[index] = max(self._next_attempt[index], attempt.number + 1)
            return True
        return attempt.was_ordered or attempt.superseded_ns is None

    def _admit(self) -> None:
        """Admit what is staged; begin anew if a clock was set back."""
        for stream in self._streams.by_name().values():
            stream.flush()
            stream.wait(NEVER)
        fast = self._streams.fast
        count = sum(stream.counts.set_back for stream in fast)
        if count == self._set_backs:
            return
        self._set_backs = count
        stream = max(fast, key=lambda s: s.counts.set_back)
        error = AttemptRejectedError(
            "the stamps of the {0} went back by {1:.3g} s: their clock was set",
            self._name(stream), seconds(stream.set_back_ns)
        )  # fmt: skip
        for attempt in self._pending:
            attempt.rejected = attempt.rejected or error
        self._streams.reset(_SETTLED_NS)
        self._probe_stamp = None

    def _outcome(self, attempt: Attempt) -> Observation | Wait:
        """Return the observation of an attempt, or what it waits for."""
        if attempt.rejected is not None:
            return attempt.rejection(attempt.rejected)
        try:
            if attempt.begin_ns < self._streams.settled_ns and self._set_backs:
                raise AttemptRejectedError("started while a clock was being set back")
            outcome = self._judge(attempt)
            if isinstance(outcome, Wait):
                self._refuse_endless(attempt, outcome)
        except AttemptRejectedError as error:
            return attempt.rejection(error)
        return outcome

    def _refuse_endless(self, attempt: Attempt, wait: Wait) -> None:
        """Raise AttemptRejectedError if what an attempt waits for is unlikely to come."""
        lag_ns = self._streams.lag_ns(attempt, wait)
        if lag_ns > self._streams.timeout_ns(wait.stream, self._settings):
            if wait.stream.single_shot:
                raise single_shot_missing(attempt, wait, lag_ns)
            raise AttemptRejectedError(
                "{0} are {1:.3g} s behind the other streams, allowed {2:g} s: silent, or "
                "stamped by another clock{3}", self._name(wait.stream), seconds(lag_ns),
                self._settings.clock_tolerance_s, self._never_came(wait.stream)
            )  # fmt: skip
        if len(self._pending) > _MAX_PENDING:
            raise AttemptRejectedError(
                "not decided before {0} later attempts started", _MAX_PENDING
            )

    def _judge(self, attempt: Attempt) -> Observation | Wait:
        """Judge an attempt by the streams, without an air quantity that is too far behind."""
        since_ns, late = self._streams.since_ns, []
        for missing in self._streams.air.missing(attempt.due_ns, since_ns, self._settings):
            wait = Wait(missing.stream, missing.stamp_ns)
            if self._streams.lag_ns(attempt, wait) <= self._tolerance_ns:
                return wait
            late.append(missing.quantity.name)
        decide = self._rules.decide[attempt.step.kind]
        outcome = decide(attempt, self._streams, self._settings)
        if late and isinstance(outcome, Observation):
            names = ", ".join(late)
            self._remarks.append(f"{attempt.step.describe()}: no {names} came in time")
        if isinstance(outcome, Observation) and outcome.accepted:
            self._refuse_without_air(outcome)
        return outcome

    def _refuse_without_air(self, observation: Observation) -> None:
        """Raise AttemptRejectedError if an observation lacks a required quantity of the air."""
        missing = [q.name for q in self._required if getattr(observation, q.column) is None]
        if missing:
            raise AttemptRejectedError(
                "no {0} of the air arrived in time: the index of refraction is unknown",
                ", ".join(missing),
            )

    def _sleep(self, attempt: Attempt, wait: Wait) -> None:
        """Let every stream report when it brings what is needed, or gets too far ahead."""
        self._waiting = wait
        too_late = (
            self._streams.reached(wait.stream, attempt)
            + self._streams.timeout_ns(wait.stream, self._settings)
            + 1
        )
        for stream in self._streams.by_name().values():
            stream.wait(too_late)
        wait.stream.wait(wait.stamp_ns, wait.samples, wait.latest_ns)

    def _name(self, stream: Stream) -> str:
        name = next(n for n, candidate in self._streams.by_name().items() if candidate is stream)
        return _WORDS.get(name, f"{name} readings")

    def _never_came(self, stream: Stream) -> Phrase:
        """Return a clause for a stream that has delivered nothing so far."""
        if stream.latest is not None or stream.counts.received:
            return NOTHING
        if stream is not self._streams.table:
            return phrase("; none has come yet")
        return phrase("; none has come yet: does cell.joint name a joint of the feedback?")

    def _not_in_plan(self, step: int) -> str:
        last = len(self._plan.steps) - 1
        return f"step {step}, which is not in the plan: it has the steps 0 to {last}"


def _reading(sample: ProbeSample) -> tuple[float, ...]:
    """Return a point as a row of the stream ``nest``."""
    return (float(sample.sequence), *sample.position)


def _elsewhere(earlier: ProbeSample, again: ProbeSample) -> bool:
    """Return whether two points are further apart than their noise explains."""
    axes = zip(earlier.position, again.position, again.position_std, strict=True)
    return any(abs(a - b) > max(6.0 * std, _NEAR_M) for a, b, std in axes)


_REMEMBERED: Final = 64
Key = tuple[int, int]
"""Step and attempt."""


class OrderAnswers:
    """Orders and the probe points that follow; ``unanswered`` counts orders replaced by the next.

    ``ordered_ns`` is how far the streams had come when the latest order came; None: not known.
    What it reports depends on the order of arrival: it is for people, never for a decision.
    """

    def __init__(self) -> None:
        self.unanswered = 0
        self.ordered_ns: int | None = None
        self._ordered: Key | None = None
        self._answered: dict[Key, None] = {}
        self._wrong: Key | None = None

    def order(self, command: Command, now_ns: int | None = None) -> None:
        """Take an order at the time of the streams; a repetition of the latest is ignored."""
        key = (command.step, command.attempt)
        if key == self._ordered:
            return
        self.unanswered += self._is_open()
        self._ordered, self._wrong, self.ordered_ns = key, None, now_ns

    def receive(self, sample: ProbeSample) -> None:
        """Take a probe point; one that was sent without an order answers none."""
        if sample.kind == PointKind.UNKNOWN:
            return
        key = (sample.step, sample.attempt)
        if key != self._ordered and not self._is_on_its_way(sample):
            self._wrong = key
        self._answered[key] = None
        if len(self._answered) > _REMEMBERED:
            del self._answered[next(iter(self._answered))]

    @property
    def open_step(self) -> int | None:
        """The step of the latest order while it has no answer."""
        return self._ordered[0] if self._ordered is not None and self._is_open() else None

    def unanswered_order(self) -> str | None:
        """Return in words which order has no answer yet."""
        if not self._is_open():
            return None
        assert self._ordered is not None
        step, attempt = self._ordered
        text = f"step {step}, attempt {attempt}: no point on probe_point answers the order"
        if self._wrong is None:
            return f"{text}: an answer names its step, its attempt and its kind"
        step, attempt = self._wrong
        return (
            f"{text}; the one that came names step {step}, attempt {attempt}: the machine must "
            "echo both from the order"
        )

    def current_fault(self) -> str | None:
        """Return in words that the latest order was answered with another step or attempt."""
        return None if self._wrong is None else self.unanswered_order()

    def _is_on_its_way(self, sample: ProbeSample) -> bool:
        """Return whether a nest that reads all the time may not know the latest order yet."""
        if sample.kind != PointKind.READING:
            return False
        self.ordered_ns = sample.stamp_ns if self.ordered_ns is None else self.ordered_ns
        return sample.stamp_ns - self.ordered_ns < _PATIENCE_NS

    def _is_open(self) -> bool:
        return self._ordered is not None and self._ordered not in self._answered
