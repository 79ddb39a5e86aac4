"""What a recording lacks: its dropouts, the steps they touch, and why observations are few."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import Dropout
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.capture import messages as records
from rotcal_ros.capture.rejections import MostFrequentReason
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.observations import Observation

IN_VAIN: Final = noted("{0} of {1} steps failed in every attempt, {2}")

_SENTENCES: Final = 20
"""Largest number of sentences; more of them would say nothing new."""
_NAMED: Final = 5
_TYPE: Final = "rotcal_msgs/msg/Observation"


@dataclass(frozen=True, slots=True)
class ObservationWindow:
    """The window of an accepted observation in log time (ns), as dropouts are.

    Stamps are those of the publisher's clock, which may differ from the recorder's or run at
    another rate: the window ends when the observation arrived.
    """

    step: int
    from_ns: int
    to_ns: int

    def touches(self, dropout: Dropout) -> bool:
        """Return whether window and dropout overlap."""
        return dropout.from_ns <= self.to_ns and self.from_ns <= dropout.to_ns


@dataclass(frozen=True, slots=True)
class DropoutWithSteps:
    """A dropout and the steps whose accepted observations it touches, ascending."""

    dropout: Dropout
    steps: tuple[int, ...]

    def describe(self) -> Phrase:
        """Return it in words."""
        if not self.steps:
            return self.dropout.describe()
        few = len(self.steps) <= _NAMED
        if len(self.steps) == 1:
            return phrase("{0}; step {1}", self.dropout.describe(), self.steps[0])
        named = phrase("{0} to {1}, {2} in all", self.steps[0], self.steps[-1], len(self.steps))
        every = ", ".join(map(str, self.steps))
        return phrase("{0}; steps {1}", self.dropout.describe(), every if few else named)

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {**self.dropout.to_dict(), "steps": list(self.steps)}


def match_dropouts(
    verdicts: Iterable[FileVerdict], windows: Iterable[ObservationWindow]
) -> tuple[DropoutWithSteps, ...]:
    """Return all dropouts in the order of time, with the steps that they touch."""
    dropouts = [dropout for verdict in verdicts for dropout in verdict.dropouts]
    all_windows = list(windows)
    return tuple(
        DropoutWithSteps(
            dropout, tuple(sorted({w.step for w in all_windows if w.touches(dropout)}))
        )
        for dropout in sorted(dropouts, key=lambda dropout: dropout.from_ns)
    )


def match_recorded_dropouts(
    verdicts: Sequence[FileVerdict], limits: ReadingLimits = DEFAULT_LIMITS
) -> tuple[DropoutWithSteps, ...]:
    """Return :func:`match_dropouts` with the observations in the files, read only where needed."""
    if not any(verdict.dropouts for verdict in verdicts):
        return ()
    return match_dropouts(verdicts, _windows(tuple(verdict.path for verdict in verdicts), limits))


def describe_dropouts(dropouts: Sequence[DropoutWithSteps]) -> tuple[Phrase, ...]:
    """Return dropouts in words; where there are many, the first ones."""
    shown = tuple(dropout.describe() for dropout in dropouts[:_SENTENCES])
    left = len(dropouts) - len(shown)
    return (*shown, phrase("and {0} more dropouts", left)) if left else shown


def _windows(files: tuple[Path, ...], limits: ReadingLimits) -> Iterator[ObservationWindow]:
    """Yield the windows of the accepted observations that the live capture had published."""
    decoders: dict[ChannelDefinition, Decoder] = {}
    for scan, block in read_blocks(files, None, limits):
        for number in () if block is None else block.counts():
            channel = scan.channels[number]
            noted = scan.metadata.get(names.TOPICS, {}).get(names.OBSERVATION)
            if channel.type_name != _TYPE or (
                channel.topic.rpartition("/")[2] != names.OBSERVATION and channel.topic != noted
            ):
                continue
            assert block is not None
            # A topic that is not defined as our observation names no steps; solving says why.
            with suppress(BagError, AttributeError, IndexError, TypeError, ValueError):
                decoder = decoders.get(channel) or Decoder(channel)
                decoders[channel] = decoder
                yield from _accepted(block.select(block.headers["channel"] == number), decoder)


def _accepted(block: Block, decoder: Decoder) -> Iterator[ObservationWindow]:
    for row, log_time_ns in enumerate(block.headers["log_time"].tolist()):
        message = decoder.message(block.payload(row))
        if message is not None and (observation := records.observation(message)).accepted:
            lasted_ns = observation.window_end_ns - observation.window_start_ns
            yield ObservationWindow(observation.step, log_time_ns - lasted_ns, log_time_ns)


_TOPICS: Final = {
    "tracer": names.TRACER_LENGTH,
    "table": names.JOINT_STATES,
    "probe": names.PROBE_POINT,
    "temperature": names.TEMPERATURE,
    "command": f"{names.TABLE_ANGLE} or {names.PROBE_TARGET}",
}
"""What delivers each stream of the capture."""
_MAX_NAMED: Final = 8
_FEW: Final = 0.1
"""Up to this share of steps without an accepted observation is not worth a warning."""


def require_accepted(
    observations: Sequence[Observation],
    counts: Mapping[str, Mapping[str, int]],
    wrong: Iterable[str],
    broken: Mapping[str, int],
    topics: Iterable[str],
) -> None:
    """Raise DataError with the reason when none of ``observations`` was accepted.

    ``counts`` is what the capture counted per stream, empty when the recorded observations were
    taken; ``wrong`` says what is wrong with topics, and ``broken`` whose messages could not be
    decoded; ``topics`` are all of the bag.
    """
    if any(observation.accepted for observation in observations):
        return
    reasons = [*map(phrase, wrong)]
    reasons += [
        phrase("{0}: {1} messages cannot be decoded", topic, count)
        for topic, count in broken.items()
    ]
    silent = [
        _TOPICS[stream]
        for stream, counted in counts.items()
        if not counted.get("received") and stream in _TOPICS
    ]
    if observations:
        reasons.append(_rejections(observations))
    elif not counts:
        reasons.append(
            phrase("no topic {0} holds any; solve its streams instead", names.OBSERVATION)
        )
    elif silent:
        reasons.append(phrase("nothing was read on {0}; {1}", ", ".join(silent), _present(topics)))
    elif counts.get("command", {}).get("unanswered"):
        reasons.append(missing_echo_warning(counts["command"]))
    else:
        reasons.append(phrase("its streams hold no complete step of the plan"))
    raise DataError(f"the bag yields no observation that was accepted: {'; '.join(reasons)}")


def _rejections(observations: Sequence[Observation]) -> Phrase:
    """Return how many were rejected, and the commonest reason."""
    most_frequent = MostFrequentReason.of(o.reason for o in observations)
    assert most_frequent is not None
    return phrase("all {0} were rejected, {1}", most_frequent.total, most_frequent.describe())


def failed_attempt_warnings(
    observations: Sequence[Observation], counts: Mapping[str, Mapping[str, int]]
) -> tuple[Phrase, ...]:
    """Return what a reader should know about failed attempts if some succeeded.

    Also how many messages contradict others: it is not known which of them are true.
    """
    texts = []
    rejected = [o.reason for o in observations if not o.accepted]
    most_frequent = MostFrequentReason.of(rejected)
    if most_frequent and 2 * most_frequent.total > len(observations):
        texts.append(
            phrase(
                "{0} of {1} attempts were rejected, {2}",
                most_frequent.total,
                len(observations),
                most_frequent.describe(),
            )
        )
    elif failed := _failed_steps(observations):
        texts.append(failed)
    texts += [
        phrase(
            "{0} messages on {1} contradict others of the same time or order: two "
            "publishers, or stamps that are too coarse; the first one counts",
            n,
            _TOPICS[stream],
        )
        for stream in ("tracer", "table", "probe")
        if (n := counts.get(stream, {}).get("contradicting", 0))
    ]
    commands = counts.get("command", {})
    if 2 * commands.get("unanswered", 0) > commands.get("received", 0):
        texts.append(missing_echo_warning(commands))
    return tuple(texts)


def _failed_steps(observations: Sequence[Observation]) -> Phrase | None:
    """Return how many steps failed in every attempt, and why; None for few (a blocked beam)."""
    done = {o.step for o in observations if o.accepted}
    failed = [o for o in observations if o.step not in done]
    most_frequent = MostFrequentReason.of(o.reason for o in failed)
    steps = len({o.step for o in failed})
    if most_frequent is None or steps <= _FEW * (len(done) + steps):
        return None
    return phrase(IN_VAIN, steps, len(done) + steps, most_frequent.describe())


def missing_echo_warning(commands: Mapping[str, int]) -> Phrase:
    """Return a sentence: the machine did not echo its orders."""
    return phrase(
        ("{0} of {1} orders were not answered: a point on {2} must echo the step and "
        "attempt of its order"),
        commands["unanswered"], commands["received"], names.PROBE_POINT
    )  # fmt: skip


def _present(topics: Iterable[str]) -> str:
    topic_names = sorted(topics)
    if not topic_names:
        return "it has no topics at all"
    left = len(topic_names) - _MAX_NAMED
    more = f" and {left} more" if left > 0 else ""
    return (
        f"its topics are {', '.join(topic_names[:_MAX_NAMED])}{more} (see --namespace, and the "
        "group topics of the set-up for other names)"
    )
