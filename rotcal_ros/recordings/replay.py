"""Solves a bag offline: the same capture and the same solver as live, hence the same result.

Two things cannot be repeated from the streams, so the live record counts. Whether clocks differ
was estimated from the times at which messages reached the capture, which no recorder knows. And a
later run continued from the recorded observations: the streams may hold one more, if a node died
between a reading and its observation; that step was measured again, and counts once.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from rotcal_ros import methods
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.names import run_number
from rotcal_ros.bags.reader import Progress, bag_files, read_blocks, sha256_of
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.bags.session_verdict import SessionVerdict, judge_session
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import (
    FileVerdict,
    Scan,
    StorageContents,
    losses_in_words,
    session_losses,
    unread_losses,
)
from rotcal_ros.bags.time_order import TimeOrder, TimeOrders, sorted_blocks
from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.capture import messages as records
from rotcal_ros.capture.announced_runs import foreign_plans
from rotcal_ros.capture.attempt import nanoseconds
from rotcal_ros.capture.instruments.steps import StepFinder
from rotcal_ros.capture.publishers import unique_run_name
from rotcal_ros.capture.stamp_offsets import OffsetLimits, is_clock_rejection, reject_observation
from rotcal_ros.capture.unordered import UnorderedStreams
from rotcal_ros.foundation.clock_jumps import jumps_from_metadata
from rotcal_ros.foundation.errors import BagError, DataError, RotcalError
from rotcal_ros.foundation.in_force import describe_contradiction, states_of_axis
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.geometry.frames import StaticFrame
from rotcal_ros.methods.configuration import Configuration, parse_configuration, read_policy
from rotcal_ros.methods.goal import GoalStanding, goal_standing
from rotcal_ros.methods.method import Trials
from rotcal_ros.planning.choices import UNTIL_GOAL
from rotcal_ros.recordings import recorded_setup
from rotcal_ros.recordings.missing_data import (
    DropoutWithSteps,
    describe_dropouts,
    failed_attempt_warnings,
    match_recorded_dropouts,
    require_accepted,
)
from rotcal_ros.recordings.streams import SLICE_NS, TIMED, RecordConsumer, StreamFeeder
from rotcal_ros.recordings.topics import RoleMessages, Topics, read_single_cell

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel

CAPTURED_OTHERWISE: Final = phrase(
    "the observations captured again differ from those captured live"
)
STRANGERS_PLANS: Final = noted(
    "ignored {0} plans on {1} from another publisher: the planner announced no such run"
)

Source = Literal["streams", "observations"]


@dataclass(frozen=True)
class Recording:
    """Everything that was read from a bag.

    ``observations`` are those of the chosen source, ``recorded`` those that the live capture had
    published; ``counts`` is what the capture counted per stream (empty when the observations were
    taken from the bag), ``broken`` the messages per topic that could not be decoded, and
    ``sha256`` maps file names to hashes. ``choices`` says why each step was measured,
    ``announced`` which tables the cell announced as in force for the measured axis, ``other_axes``
    for which other axes it did so. ``frames`` are its static transforms, ``unreadable`` says why
    topics could not be read, ``clock`` how the system clock jumped, ``session`` whether all files
    are there, ``dropouts`` what the recorder itself missed, ``foreign_plans`` how many
    plans belong to no run of the bag's planner, ``stream_faults`` what is wrong with the joints.

    >>> import rotcal_ros as rc
    >>> recording = rc.read_bag("examples/data/ball_plate_bag")
    >>> recording.warnings(), recording.solve().verdict
    ((), 'ok')
    """

    calibration: methods.Calibration
    source: Source
    observations: tuple[Observation, ...]
    recorded: tuple[Observation, ...]
    verdicts: tuple[FileVerdict, ...]
    counts: Mapping[str, Mapping[str, int]]
    broken: Mapping[str, int]
    sha256: Mapping[str, str]
    attachments: Mapping[str, bytes]
    choices: tuple[recorded_setup.RecordedChoice, ...] = ()
    announced: frozenset[str] = frozenset()
    other_axes: tuple[str, ...] = ()
    frames: tuple[StaticFrame, ...] = ()
    unreadable: Mapping[str, str] = field(default_factory=dict)
    clock: tuple[str, ...] = ()
    session: SessionVerdict = field(default_factory=SessionVerdict)
    dropouts: tuple[DropoutWithSteps, ...] = ()
    foreign_plans: int = 0
    stream_faults: tuple[str, ...] = ()

    @property
    def configuration(self) -> Configuration:
        """The configuration with which it is solved."""
        return self.calibration.configuration

    def solve(self) -> Result:
        """Return the result; equal observations give equal results to the last bit.

        It also carries the warnings about the bag, and its verdict is at best suspect if the bag
        or its metadata shows that messages are missing.
        """
        self._require_observations()
        try:
            result = self.calibration.solve(self.observations, self.announced, self.frames)
        except DataError as error:
            reasons = [str(error), *failed_attempt_warnings(self.observations, self.counts)]
            raise type(error)("; ".join(reasons), error.log) from error
        return self.with_warnings(result)

    def with_warnings(self, result: Result) -> Result:
        """Return a ``result`` of these observations with the warnings about the bag."""
        further = tuple(text for text in self.warnings() if text not in result.warnings)
        warned = replace(result, warnings=(*result.warnings, *further))
        short = self.session.missing or any(v.shows_loss for v in self.verdicts)
        return warned.as_suspect() if short else warned

    def model_of_curves(self) -> CurveModel | None:
        """Return the observations as a model, to be solved with those of other instruments."""
        self._require_observations()
        return self.calibration.model_of_curves(self.observations)

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about the observations."""
        self._require_observations()
        return self.calibration.trials(self.observations)

    def goal_standing(self, result: Result) -> GoalStanding | None:
        """Return how ``result`` compares with the goal of the policy; None if there is none.

        Raises ConfigurationError or PlanError when the bag's configuration cannot be used.
        """
        calibration = self._as_chosen()
        if calibration is None:
            return None
        choices = [recorded.choice for recorded in self.choices]
        return goal_standing(calibration, result, choices, self.observations)

    def _require_observations(self) -> None:
        """Raise DataError with the reason when no observation was accepted."""
        topics = {name for verdict in self.verdicts for name in verdict.topics}
        wrong = *self.stream_faults, *self.unreadable.values()
        require_accepted(self.observations, self.counts, wrong, self.broken, topics)

    def _as_chosen(self) -> methods.Calibration | None:
        """Return the calibration whose policy chose the steps; None if it only listed them."""
        if not self.choices or names.CONFIGURATION not in self.attachments:
            return None
        text = self.attachments[names.CONFIGURATION].decode(errors="replace")
        if read_policy(text) != UNTIL_GOAL:
            return None
        return methods.prepare(parse_configuration(text, "the bag's configuration"))

    @property
    def same_as_recorded(self) -> bool:
        """Whether the final observations equal those of the live capture.

        After the last recorded one of a run there may be more: nodes that were killed had the
        readings on disk before they could publish the observation.
        """
        again, live = map(methods.last_accepted, (self.observations, self.recorded))
        last_end_ns: defaultdict[int, int] = defaultdict(int)
        for (run, _), observation in live.items():
            last_end_ns[run] = max(last_end_ns[run], observation.window_end_ns)
        further = {key: o for key, o in again.items() if key not in live}
        all_later = all(o.window_end_ns > last_end_ns[run] for (run, _), o in further.items())
        return all_later and again == {**live, **further}

    def choices_that_differ(self) -> tuple[str, ...]:
        """Return where the policy chooses otherwise with the observations of this recording.

        The policy is that of the configuration in the bag, with which the steps were chosen. This
        plans the measurement again, which takes longer than solving it.
        """
        try:
            calibration = self._as_chosen()
            if calibration is None:
                return ()
            return recorded_setup.policy_differences(calibration, self.choices, self.observations)
        except RotcalError as error:
            return (phrase("the policy cannot choose again: {0}", error),)

    def warnings(self) -> tuple[Phrase, ...]:
        """Return the warnings about the bag for the reader of a result."""
        texts = [*self.session.missing, *self.session.repaired]
        texts += [
            phrase("{0}: {1}", v.path.name, v.describe())
            for v in self.verdicts
            if v.state != "complete"
        ]
        texts += losses_in_words(session_losses(self.verdicts))
        texts += unread_losses(self.verdicts)
        texts += [*self.unreadable.values(), *self.clock, *describe_dropouts(self.dropouts)]
        texts += failed_attempt_warnings(self.observations, self.counts)
        texts += _undecoded(self.broken)
        texts += _left_alone(self.verdicts)
        if self.foreign_plans:
            texts.append(phrase(STRANGERS_PLANS, self.foreign_plans, names.PLAN))
        if self.recorded and not self.same_as_recorded:
            texts.append(CAPTURED_OTHERWISE)
        if clash := describe_contradiction(self.calibration.in_force(self.announced)):
            texts.append(clash)
        if self.other_axes:
            texts.append(
                phrase(
                    "the cell announced the table in force of axis {0}: ignored for axis {1}",
                    ", ".join(self.other_axes),
                    self.calibration.configuration.cell.axis,
                )
            )
        return tuple(map(phrase, texts))


def read_recording(
    path: Path,
    source: Source = "streams",
    *,
    configuration: Configuration | None = None,
    topics: Topics | None = None,
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> Recording:
    """Read a bag and capture its observations again, or take the recorded ones.

    Without ``configuration`` the one in the bag is used: the attachment, else the text on the
    ``plan`` topic. Raises BagError when the bag cannot be read, holds no configuration, two that
    differ, or files of several sessions, and DataError when it was recorded with another method
    than that of ``configuration``. Memory does not grow with the size of the bag.
    """
    files = bag_files(path)
    require_one_session(files, limits)
    asked = _ReadRequest(path, files, source, configuration, progress, limits)
    return read_single_cell(partial(_recording, asked), topics or Topics(), files, limits)


@dataclass(frozen=True)
class _ReadRequest:
    """What is asked of the ``files`` of a bag; ``configuration`` None: the one in the bag."""

    path: Path
    files: tuple[Path, ...]
    source: Source
    configuration: Configuration | None
    progress: Progress | None
    limits: ReadingLimits


def _recording(
    asked: _ReadRequest, topics: Topics, left_out: frozenset[str] = frozenset()
) -> Recording:
    """Do as :func:`read_recording`; raise AmbiguousCellError if it is not clear which cell.

    ``left_out`` are the runs of plans that are known to be a stranger's.
    """
    path, files, source, limits = asked.path, asked.files, asked.source, asked.limits
    configuration = asked.configuration or recorded_setup.find_configuration(
        files, topics, limits, left_out
    )
    topics.follow(configuration.topics.renamed())
    calibration = methods.prepare(configuration)
    make = partial(_feeder, calibration, configuration)
    passes = partial(read_blocks, files, asked.progress, limits)
    contents, feeder, order = _read_in_order(
        passes, topics, make, source, _allowed_disorder_ns(configuration)
    )
    verdicts = tuple(scan.verdict() for scan in contents.scans)
    _require_messages(verdicts, path)
    if source == "streams" and (changing := feeder.joints.changing()):
        raise DataError(changing)
    attached, planned, foreign = _plans(contents, files, limits)
    if asked.configuration is None:
        of_strangers = {text for run, text in contents.planned if run in foreign - left_out}
        if configuration.text in of_strangers.difference(attached, planned):
            return _recording(asked, topics, foreign)
        recorded_setup.require_one_configuration(contents.scans, planned, path)
    attachments = {n: a.data for scan in contents.scans for n, a in scan.attachments.items()}
    texts = (attachments.get(names.CONFIGURATION, b"").decode(errors="replace"), *planned)
    set_ups = tuple(recorded_setup.recorded_configurations(texts))
    recorded_setup.require_same_method(configuration, set_ups, path)
    if source == "streams" and configuration.method.of_turns and contents.without_orders:
        calibration, captured, feeder = _turns(asked, calibration, topics)
    else:
        captured = _captured(feeder, contents, configuration, set_ups)
    broken = _unread(contents, topics)
    as_recorded = recorded_setup.with_recorded_facts(
        calibration.configuration, texts, contents.scans
    )
    clocks = filter(None, [feeder.offset or feeder.doubt])
    return Recording(
        calibration=replace(calibration, configuration=as_recorded),
        source=source,
        observations=captured if source == "streams" else tuple(contents.recorded),
        recorded=tuple(contents.recorded),
        verdicts=verdicts,
        counts=feeder.counts if source == "streams" else {},
        broken=broken,
        sha256={file.name: sha256_of(file) for file in files},
        attachments=attachments,
        choices=tuple(contents.choices),
        announced=frozenset(states_of_axis(contents.announced, configuration.cell.axis)),
        other_axes=contents.other_axes(configuration.cell.axis),
        frames=tuple(contents.frames.values()),
        unreadable=dict(topics.unreadable),
        clock=(*describe_clock(contents.scans, order), *clocks),
        session=judge_session(path, verdicts),
        dropouts=match_recorded_dropouts(verdicts, limits),
        foreign_plans=len(foreign),
        stream_faults=tuple(feeder.joints.faults()) if source == "streams" else (),
    )


def _plans(
    contents: _BagContents, files: tuple[Path, ...], limits: ReadingLimits
) -> tuple[set[str], list[str], frozenset[str]]:
    """Return the configurations that are attached, those of the cell's plans, and strangers' runs.

    Plans are a stranger's only where a bag holds configurations that differ.
    """
    attached = {text for text, _ in recorded_setup.attached_configurations(contents.scans)}
    differ = len(attached.union(text for _, text in contents.planned)) > 1
    foreign = foreign_plans(files, contents.planned, attached, limits) if differ else frozenset()
    return attached, [text for run, text in contents.planned if run not in foreign], foreign


def _turns(
    asked: _ReadRequest, calibration: methods.Calibration, topics: Topics
) -> tuple[methods.Calibration, tuple[Observation, ...], StreamFeeder]:
    """Return the plan and the lengths of turns that nobody ordered, and what read them.

    Raises DataError where it is not known which joint is the table.
    """
    configuration, streams = calibration.configuration, UnorderedStreams()
    make = partial(_feeder, calibration, configuration, lambda _run: streams)
    passes = partial(read_blocks, asked.files, None, asked.limits)
    tolerance_ns = _allowed_disorder_ns(configuration)
    contents, feeder, _ = _read_in_order(passes, topics, make, "streams", tolerance_ns)
    if open_question := next(feeder.joints.faults(), None):
        raise DataError(open_question)
    assert configuration.method.of_turns is not None
    try:
        found = configuration.method.of_turns(configuration, streams, str(asked.path))
    except DataError as error:
        verdicts = [scan.verdict() for scan in contents.scans]
        damage = next((f"{v.path.name}: {v.describe()}" for v in verdicts if not v.whole), "")
        raise DataError(f"{error}; {damage}") if damage else error from error
    offsets = [feeder.offset] * len(found.observations)
    return found.calibration, apply_clock_limit(found.observations, offsets, ()), feeder


def _captured(
    feeder: StreamFeeder,
    contents: _BagContents,
    configuration: Configuration,
    set_ups: Sequence[Configuration],
) -> tuple[Observation, ...]:
    """Return what was captured again, with what only the live capture knew of the clocks."""
    judged_live = contents.recorded if has_same_clock_limit(configuration, set_ups[:1]) else ()
    captured = apply_clock_limit(feeder.observations, feeder.offsets, judged_live)
    return keep_known_to_later_runs(captured, contents.recorded, contents.scans)


def _unread(contents: _BagContents, topics: Topics) -> dict[str, int]:
    """Note what could not be read; return how many messages of each topic were not decoded."""
    decoders = contents.decoders.items()
    topics.unreadable.update({c.topic: d.unreadable for c, d in decoders if d.unreadable})
    broken = {c.topic: d.broken for c, d in decoders if d.broken}
    note_unread((*topics.unreadable.values(), *_undecoded(broken)))
    return broken


def _undecoded(broken: Mapping[str, int]) -> list[str]:
    """Return how many messages of each topic could not be decoded."""
    return [
        phrase("{0}: {1} messages cannot be decoded", topic, count)
        for topic, count in broken.items()
    ]


def _left_alone(verdicts: Sequence[FileVerdict]) -> list[str]:
    """Return how many messages the run ignored; the recorder puts them on topics of their own."""
    ending = f"_{names.LEFT_ALONE}"
    count = Counter({
        topic: sum(v.topics[topic].messages for v in verdicts if topic in v.topics)
        for topic in {t for v in verdicts for t in v.topics if t.endswith(ending)}
    })  # fmt: skip
    return [
        phrase(
            "ignored {0} messages on {1} from a publisher that joined during the run; "
            "they are kept in {2}",
            n,
            topic.rpartition("/")[2].removesuffix(ending),
            topic,
        )
        for topic, n in sorted(count.items())
    ]


def _feeder(
    calibration: methods.Calibration,
    configuration: Configuration,
    make: Callable[[int], RecordConsumer] | None = None,
) -> StreamFeeder:
    """Return a feeder that captures the streams again as they were planned, or for ``make``."""
    return StreamFeeder(
        make or calibration.capture,
        configuration.cell.joint,
        lambda: StepFinder(
            calibration.plan,
            configuration.capture,
            configuration.topics.tip_radius_m,
            single_shot=configuration.topics.probe_single_shot,
        ),
        configuration.topics,
        _allowed_disorder_ns(configuration),
        OffsetLimits.of(configuration.capture),
    )


def _allowed_disorder_ns(configuration: Configuration) -> int:
    """Return how far apart streams may be when fed to the capture, well below its limit."""
    return min(SLICE_NS, nanoseconds(0.1 * configuration.capture.clock_tolerance_s))


def _require_messages(verdicts: Sequence[FileVerdict], path: Path) -> None:
    """Raise BagError, with the first damage, if no file holds a message."""
    if not any(verdict.messages for verdict in verdicts):
        bad = next((v.describe() for v in verdicts if v.state != "complete"), "")
        raise BagError(
            f"the bag {path} holds no messages{bad and f' that can be read: {bad}'}; name "
            "another, or try rotcal bag repair"
        )


_STREAMS: Final = {names.TRACER_LENGTH, names.JOINT_STATES}
_ORDERS: Final = {names.PLAN, names.TABLE_ANGLE, names.PROBE_TARGET, names.PROBE_POINT}


@dataclass
class _BagContents:
    """What the files of a bag hold besides the streams."""

    recorded: list[Observation] = field(default_factory=list)
    planned: list[tuple[str, str]] = field(default_factory=list)
    choices: list[recorded_setup.RecordedChoice] = field(default_factory=list)
    announced: set[tuple[str, str]] = field(default_factory=set)
    frames: dict[str, StaticFrame] = field(default_factory=dict)
    scans: list[Scan] = field(default_factory=list)
    order: TimeOrders = field(default_factory=TimeOrders)
    decoders: recorded_setup.Decoders = field(default_factory=dict)
    roles: set[str] = field(default_factory=set)

    @property
    def without_orders(self) -> bool:
        """Whether lengths and angles are all there is: no plan, no order, no place of a probe."""
        return self.roles >= _STREAMS and not self.roles & _ORDERS

    def other_axes(self, axis: str) -> tuple[str, ...]:
        """Return for which axes beside ``axis`` tables were announced."""
        return tuple(sorted({a for a, _ in self.announced} - {"", axis}))

    def add(self, part: RoleMessages, block: Block) -> None:
        """Add the messages of a part that is not a stream."""
        if part.role == names.OBSERVATION:
            self.recorded += (records.observation(m) for _, m in part.messages(block))
        elif part.role == names.PLAN:
            self.planned += (
                (unique_run_name(m), m.configuration) for _, m in part.messages(block)
            )
        elif part.role == names.STEP_CHOICE:
            self.choices += (recorded_setup.RecordedChoice.of(m) for _, m in part.messages(block))
        elif part.role == names.TABLE_IN_FORCE:
            self.announced |= {(m.axis, m.in_force) for _, m in part.messages(block)}
        elif part.role == names.TF_STATIC:
            for _, message in part.messages(block):
                self.frames |= {f.child: f for f in records.static_frames(message)}


def _read_in_order(
    passes: Callable[[], Iterable[tuple[Scan, Block | None]]],
    topics: Topics,
    make: Callable[[], StreamFeeder],
    source: Source,
    tolerance_ns: int,
) -> tuple[_BagContents, StreamFeeder, TimeOrder]:
    """Read all files, and again, sorted by time, if they are not in the order of time."""
    feeder, scans = make(), list[Scan]()
    contents = _read(
        _collect_scans(passes(), scans), topics, feeder if source == "streams" else None
    )
    order = contents.order.judged(tolerance_ns)
    if order.sort_by is not None:
        feeder = make()
        blocks = sorted_blocks(passes(), contents.decoders, order.sort_by)
        contents = _read(blocks, topics, feeder if source == "streams" else None)
    contents.scans = scans
    return contents, feeder, order


def _collect_scans(
    blocks: Iterable[tuple[Scan, Block | None]], scans: list[Scan]
) -> Iterator[tuple[StorageContents, Block]]:
    """Yield the blocks; put finished passes into ``scans``."""
    for scan, block in blocks:
        if block is None:
            scans.append(scan)
        else:
            yield scan, block


def _read(
    blocks: Iterable[tuple[StorageContents, Block]], topics: Topics, feeder: StreamFeeder | None
) -> _BagContents:
    """Read all files once; the streams go to ``feeder``."""
    contents, run = _BagContents(), 0
    for scan, block in blocks:
        before, run = run, run_number(scan.metadata, run)
        if feeder is not None and run != before:
            feeder.begin_run(run)
        parts = topics.split(block, scan, contents.decoders)
        timed = [(part.decoder, part.rows) for part in parts if part.role in TIMED]
        contents.order.look(block, timed, scan.path.name, run)
        for part in parts:
            contents.roles.add(part.role)
            with part.checked():
                contents.add(part, block)
        if feeder is not None:
            feeder.feed(block, parts)
    return contents


def apply_clock_limit(
    observations: Iterable[Observation],
    estimates: Sequence[Phrase | None],
    recorded: Iterable[Observation],
) -> tuple[Observation, ...]:
    """Return the observations, rejected if the clocks of their streams differ.

    The ``recorded`` observation of the same attempt counts; without one (foreign bags, killed
    nodes) the estimate from the bag at each observation does, empty for equal clocks.
    """
    live = {_attempt(o): o.reason for o in recorded if o.accepted or is_clock_rejection(o.reason)}
    return tuple(
        reject_observation(live.get(_attempt(observation), estimate), observation)
        for observation, estimate in zip(observations, estimates, strict=True)
    )


def has_same_clock_limit(configuration: Configuration, recorded: Iterable[Configuration]) -> bool:
    """Return whether the clocks may differ as much as when it was ``recorded``."""
    allowed = OffsetLimits.of(configuration.capture)
    return all(OffsetLimits.of(before.capture) == allowed for before in recorded)


def _attempt(observation: Observation) -> tuple[int, int, int]:
    return observation.run, observation.step, observation.attempt


_SHOWN: Final = 5


def describe_clock(scans: Sequence[Scan], order: TimeOrder) -> tuple[str, ...]:
    """Return how the recorder's clock jumped, a line for each, or that log times are unordered.

    If jumps were noted, they explain log times that go back.
    """
    jumps = [
        j for scan in scans for j in jumps_from_metadata(scan.metadata.get(names.CLOCK_JUMPS, {}))
    ]
    jumps = sorted(set(jumps), key=lambda jump: (not jump.named, jump.at_ns))
    texts = [jump.describe() for jump in jumps[:_SHOWN]]
    if len(jumps) > _SHOWN:
        texts.append(phrase("the system clock jumped {0} more times", len(jumps) - _SHOWN))
    if not (jumps and order.back):
        texts += order.describe()
    return tuple(texts)


def keep_known_to_later_runs(
    captured: Iterable[Observation], recorded: Iterable[Observation], scans: Iterable[Scan]
) -> tuple[Observation, ...]:
    """Return the observations without those of earlier runs that later runs did not know."""
    continued = (
        scan.metadata
        for scan in scans
        if scan.metadata.get(names.RUN, {}).get("earlier") == names.RECORDED
    )
    last = max(map(run_number, continued), default=0)
    known = {(o.run, o.step, o.attempt) for o in recorded}
    return tuple(o for o in captured if o.run >= last or (o.run, o.step, o.attempt) in known)
