"""What a bag says about its measurement: configuration, subject, and the planner's choices."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from threadpoolctl import threadpool_limits

from rotcal_ros import methods
from rotcal_ros.bags import names
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import scan_file
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import Scan
from rotcal_ros.capture.messages import coded_phrase
from rotcal_ros.capture.publishers import unique_run_name
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods.configuration import (
    OFFLINE_GROUPS,
    Configuration,
    parse_configuration,
    read_subject,
)
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.planning.choices import AS_LISTED, PolicyProgress, StepChoice, StepOutcome
from rotcal_ros.recordings.topics import Topics

Decoders = dict[ChannelDefinition, Decoder]
SOLVED_APART: Final = (
    "give the set-up that was used: `rotcal solve BAG --setup SETUP.yaml -o RESULT.json` "
    "(other verbs take RESULT.json)"
)
Subject = tuple[Identity, bool]
"""What is measured, and whether the cell is a simulation."""


def find_configuration(
    files: tuple[Path, ...],
    topics: Topics,
    limits: ReadingLimits = DEFAULT_LIMITS,
    strangers: Collection[str] = (),
) -> Configuration:
    """Return the configuration that a bag was recorded with; reads no further than needed.

    Plans for the runs of ``strangers`` do not count.
    """
    for file in files:
        scan = scan_file(file, limits)
        for text in _configuration_texts(scan, topics, strangers):
            source = f"{file.name}: {names.CONFIGURATION}"
            return parse_configuration(text, source, OFFLINE_GROUPS)
    raise BagError(
        f"{files[0].parent if len(files) > 1 else files[0]} holds no configuration: neither the "
        f"attachment {names.CONFIGURATION} nor a message on the topic {names.PLAN}; "
        f"{SOLVED_APART}"
    )


def attached_configurations(scans: Iterable[Scan]) -> Iterator[tuple[str, str]]:
    """Yield (text, name of the file) of all attachments with a configuration."""
    for scan in scans:
        for kept in (scan.replaced, scan.attachments):
            if names.CONFIGURATION in kept:
                text = kept[names.CONFIGURATION].data.decode(errors="replace")
                yield text, scan.path.name


def require_one_configuration(scans: Iterable[Scan], planned: Iterable[str], path: Path) -> None:
    """Raise BagError, with the lines, if a bag states two configurations that differ.

    ``planned`` are the texts of its plans. The bag does not say which one was used: a set-up has
    to be given.
    """
    texts: dict[str, str] = {}
    for text, file in attached_configurations(scans):
        texts.setdefault(text, f"the attachment of {file}")
    for text in planned:
        texts.setdefault(text, f"a message on the topic {names.PLAN}")
    if len(texts) > 1:
        (first, place), (second, other), *_ = texts.items()
        raise BagError(
            f"{path} holds {len(texts)} configurations that differ, {place} and {other}: "
            f"{_first_differing_line(first, second)}; {SOLVED_APART}"
        )


def _first_differing_line(first: str, second: str) -> str:
    """Return in words where two texts begin to differ."""
    pairs = zip_longest(first.splitlines(), second.splitlines(), fillvalue="")
    for line, (ours, theirs) in enumerate(pairs, 1):
        if ours != theirs:
            here, there = ours.strip(), theirs.strip()
            return f"line {line} is {here!r:.80} in one and {there!r:.80} in the other"
    return "in their line endings"


def recorded_configurations(texts: Iterable[str]) -> Iterator[Configuration]:
    """Yield the configurations in a bag that can be read."""
    for text in texts:
        with suppress(ConfigurationError):
            yield parse_configuration(text, names.CONFIGURATION, OFFLINE_GROUPS)


def require_same_method(
    configuration: Configuration, recorded: Iterable[Configuration], path: Path
) -> None:
    """Raise DataError when the method of ``configuration`` is not that of those ``recorded``."""
    for method in (known.method.name for known in recorded):
        if method != configuration.method.name:
            raise DataError(
                f"{path} was recorded with the method {method}, but {configuration.source} sets "
                f"up {configuration.method.name}: give the set-up that belongs to it, or leave it "
                "out to use the one in the bag"
            )


def _subjects(texts: Iterable[str], scans: Iterable[Scan]) -> Iterator[Subject]:
    """Yield what was measured, by the configurations of a bag first, then by its recorder.

    Settings that cannot be read do not hide it.
    """
    for text in texts:
        with suppress(ConfigurationError):
            yield read_subject(text, names.CONFIGURATION)
    for note in (scan.metadata.get(names.SUBJECT, {}) for scan in scans):
        yield Identity(item=note.get("item", "")), note.get("simulated") == "true"


def with_recorded_facts(
    configuration: Configuration, texts: Iterable[str], scans: Iterable[Scan]
) -> Configuration:
    """Return the configuration with those facts of a recording that no set-up can change.

    A simulation stays one; who measured what is taken from the bag unless it is given: from the
    ``texts`` of its configurations, then from its recorder. The first statement counts.
    """
    subjects = tuple(_subjects(texts, scans))
    identity = configuration.identity
    if "identity" not in configuration.given:
        stated = (known for known, _ in subjects if known != Identity())
        identity = next(stated, identity)
    simulated = configuration.simulated or any(simulated for _, simulated in subjects)
    return replace(configuration, simulated=simulated, identity=identity)


def _configuration_texts(scan: Scan, topics: Topics, strangers: Collection[str]) -> Iterator[str]:
    decoders: Decoders = {}
    for block in scan.blocks():
        if names.CONFIGURATION in scan.attachments:
            break
        for part in topics.split(block, scan, decoders):
            if part.role == names.PLAN:
                with part.checked():
                    yield from (
                        message.configuration
                        for _, message in part.messages(block)
                        if unique_run_name(message) not in strangers
                    )
    if names.CONFIGURATION in scan.attachments:
        yield scan.attachments[names.CONFIGURATION].data.decode(errors="replace")


ENDLESS: Final = 2**62


@dataclass(frozen=True)
class RecordedChoice:
    """One choice of a run; ``attempt`` is the first one that belongs to it."""

    run: int
    number: int
    attempt: int
    choice: StepChoice

    @classmethod
    def of(cls, message: Any) -> RecordedChoice:
        """Return what a rotcal_msgs/StepChoice says."""
        standing = PolicyProgress(message.left, message.uncertainty, message.goal)
        step = None if message.stop else message.step
        choice = StepChoice(
            step, coded_phrase(message.reason, getattr(message, "reason_code", None)), standing
        )
        return cls(message.run, message.number, message.attempt, choice)


def policy_differences(
    calibration: methods.Calibration,
    choices: Sequence[RecordedChoice],
    observations: Iterable[Observation],
) -> tuple[str, ...]:
    """Return where the policy, with the recorded observations, chooses otherwise than it did.

    ``calibration`` has the settings of the planner. The policy as_listed makes no choices.
    """
    if calibration.configuration.planner.policy == AS_LISTED:
        return ()
    every = tuple(observations)
    found = []
    for run in sorted({recorded.run for recorded in choices}):
        mine = sorted((c for c in choices if c.run == run), key=lambda c: c.number)
        continuation = _continuation(calibration, run, [o for o in every if o.run < run])
        with threadpool_limits(1, "blas"):  # as the planner
            text = _first_difference(
                calibration, continuation, mine, [o for o in every if o.run == run]
            )
        if text is not None:
            found.append(text)
    return tuple(found)


def _continuation(
    calibration: methods.Calibration, run: int, earlier: Sequence[Observation]
) -> Continuation:
    """Return what a run continued from."""
    if run == 0:
        return calibration.first_run()
    return calibration.continued(run, earlier)


def _first_difference(
    calibration: methods.Calibration,
    continuation: Continuation,
    choices: Sequence[RecordedChoice],
    observations: Sequence[Observation],
) -> str | None:
    """Return the first choice in which the policy differs, None if there is none."""
    policy = calibration.policy(continuation)
    for place, recorded in enumerate(choices):
        again = policy.choose()
        if recorded.number != place or not again.same_as(recorded.choice):
            return (
                f"run {recorded.run}, choice {place}: the planner chose "
                f"{_in_words(recorded.choice)}, but from the recorded observations the policy "
                f"chooses {_in_words(again)}"
            )
        if recorded.choice.step is not None:
            policy.note(_outcome(recorded, choices[place + 1 :], observations))
    return None


def _outcome(
    recorded: RecordedChoice, later: Sequence[RecordedChoice], observations: Sequence[Observation]
) -> StepOutcome:
    """Return the outcome of a chosen step: the last accepted one of its attempts."""
    step = recorded.choice.step
    assert step is not None
    behind = min((c.attempt for c in later if c.choice.step == step), default=ENDLESS)
    accepted = [
        o
        for o in observations
        if o.step == step and o.accepted and recorded.attempt <= o.attempt < behind
    ]
    return StepOutcome(step, max(accepted, key=lambda o: o.attempt, default=None))


def _in_words(choice: StepChoice) -> str:
    step = "to stop" if choice.step is None else f"step {choice.step}"
    return f"{step} ({choice.reason}; {choice.standing.left} left)"
