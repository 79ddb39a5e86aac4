"""The part of a recorded bag that is published again, and what its nodes had made of it.

No ROS.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import Progress, bag_files, read_blocks
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.bags.storage_scan import Scan
from rotcal_ros.bags.topic_roles import TopicRoleFinder
from rotcal_ros.capture import messages
from rotcal_ros.capture.announced_runs import foreign_plans
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.publishers import unique_run_name
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.configuration import read_topics

OUTPUTS: Final = frozenset({
    names.OBSERVATION, names.OBSERVATION_RECORDED, "deviations", "compensation_table",
    "volumetric_correction", "axis_location", "scene", "scene_motion", names.HEARTBEAT,
    names.DROPOUTS, names.GOAL, names.PROGRESS,
})  # fmt: skip
"""Last names of the topics that our own nodes make of the streams: live nodes make them again."""
OF_ROS: Final = ("/diagnostics", "/rosout", "/parameter_events", "/clock")
CLOCK: Final = "/clock"
_PACKAGE: Final = "rotcal_msgs/"
Attempt = tuple[int, int, int]
"""Run, step and attempt."""


@dataclass
class ReplayedBag:
    """A bag that is published again: its channels by topic, and what is left out for which reason.

    ``outputs`` are the topics that our own nodes had published, ``accepted`` the observations that
    the recorded capture had accepted, ``steps`` those of the last run, ``plan_id`` and
    ``configuration`` those of the plan; empty if the bag has none. ``strangers`` are the runs of
    plans that were not the planner's: they are left out. Times in ns.
    """

    files: tuple[Path, ...]
    channels: dict[str, ChannelDefinition] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    outputs: set[str] = field(default_factory=set)
    left_out: dict[str, str] = field(default_factory=dict)
    called: TopicRoleFinder = field(default_factory=lambda: TopicRoleFinder("/cell"))
    namespace: str = "/cell"
    plan_id: str = ""
    configuration: str = ""
    strangers: frozenset[str] = frozenset()
    accepted: dict[Attempt, Observation] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0

    @classmethod
    def read(
        cls, path: Path, *, everything: bool = False, progress: Progress | None = None
    ) -> ReplayedBag:
        """Look through a bag; BagError if there is none, or nothing in it to publish.

        ``everything``: what our own nodes had made of the streams is published too.
        """
        files = bag_files(path)
        require_one_session(files)
        contents = _BagPass()
        for scan, block in read_blocks(files, progress):
            if block is not None:
                contents.add(scan, block)
        bag = cls(files, contents.channels, contents.counts)
        bag._find_roles(contents)
        if not contents.counts:
            raise BagError(
                f"the bag {path} holds no messages: there is nothing to replay; name another"
            )
        bag.start_ns, bag.end_ns = contents.start_ns, contents.end_ns
        bag._leave_out(everything)
        if not bag.channels:
            raise BagError(
                f"the bag {path} holds nothing but what nodes made of it, or what cannot be "
                f"published: {', '.join(sorted(bag.left_out))}; --all publishes that too"
            )
        return bag

    @property
    def seconds(self) -> float:
        """Duration of the recording, s."""
        return (self.end_ns - self.start_ns) * NANOSECOND

    @property
    def steps(self) -> list[int]:
        """The steps that have an accepted observation of the last run."""
        last = max((run for run, _, _ in self.accepted), default=0)
        return sorted({step for run, step, _ in self.accepted if run == last})

    def roles(self, *wanted: str) -> list[str]:
        """Return the published topics of some roles."""
        return [topic for topic in self.channels if self.called.role(topic) in wanted]

    def taken_when_sent(self) -> list[str]:
        """Return the published topics whose messages get the time of sending, which is now."""
        sent, role = Conventions(read_topics(self.configuration)).by_sending, self.called.role
        return sorted(t for t, c in self.channels.items() if sent(role(t), c.type_name))

    def remappings(self) -> list[str]:
        """Return the remappings that the nodes need to hear all of it."""
        return [f"-r {role}:={topic}" for role, topic in sorted(self.called.topics.items())]

    def _find_roles(self, contents: _BagPass) -> None:
        """Find which topics play which role, and what plan and observations say."""
        self.called.topics = {r: t for r, t in contents.names.items() if r in names.ROLES}
        plan = self.called.topics.get(names.PLAN)
        plans = [
            topic
            for topic, channel in self.channels.items()
            if topic == plan
            or (_last(topic) == names.PLAN and channel.type_name.startswith(_PACKAGE))
        ]
        if len(plans) > 1:
            raise BagError(
                f"the bag holds the plans of several cells ({', '.join(sorted(plans))}): "
                "one is replayed at a time"
            )
        of_nodes = [t for t in self.channels if t.rpartition("/")[2] == names.HEARTBEAT]
        for topic in plans if plan is None else of_nodes:
            self.namespace = topic.rpartition("/")[0] or "/"
        renamed, self.called = self.called.topics, TopicRoleFinder(self.namespace)
        self.called.topics = renamed
        for topic in plans:
            announced = [(unique_run_name(plan), plan) for plan in contents.messages(topic)]
            texts = [(run, plan.configuration) for run, plan in announced]
            self.strangers = foreign_plans(self.files, texts)
            for run, plan in announced:
                if run not in self.strangers:
                    self.plan_id, self.configuration = plan.plan_id, plan.configuration
        for topic in self.channels:
            if self.called.role(topic) == names.OBSERVATION:
                self.accepted = contents.accepted(topic)

    def _leave_out(self, everything: bool) -> None:
        for topic, channel in sorted(self.channels.items()):
            if is_output := topic in OF_ROS or self.called.role(topic) in OUTPUTS:
                self.outputs.add(topic)
            if topic == CLOCK or "/_" in topic:
                self.left_out[topic] = "it belongs to the nodes of that time"
            elif is_output and not everything:
                self.left_out[topic] = "nodes made it of the streams (--all)"
            elif channel.message_encoding not in ("", "cdr"):
                self.left_out[topic] = f"it is serialised as {channel.message_encoding!r}, not cdr"
        self.leave_out(self.left_out)

    def leave_out(self, reasons: Mapping[str, str]) -> None:
        """Leave some topics out, each for a reason."""
        self.left_out |= reasons
        for topic in reasons:
            self.channels.pop(topic, None)


@dataclass
class _BagPass:
    """What one pass over the files of a bag finds."""

    channels: dict[str, ChannelDefinition] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    start_ns: int = 1 << 63
    end_ns: int = 0
    _payloads: dict[str, list[bytes]] = field(default_factory=dict)

    def add(self, scan: Scan, block: Block) -> None:
        """Add a block."""
        self.names |= scan.metadata.get(names.TOPICS, {})
        times = block.headers["log_time"]
        self.start_ns = min(self.start_ns, int(times.min()))
        self.end_ns = max(self.end_ns, int(times.max()))
        wanted = (names.PLAN, names.OBSERVATION)
        of_interest = {self.names.get(role) for role in wanted}
        for number, count in block.counts().items():
            channel = scan.channels[number]
            self.channels.setdefault(channel.topic, channel)
            self.counts[channel.topic] = self.counts.get(channel.topic, 0) + count
            ours = channel.type_name.startswith(_PACKAGE)
            if ours and (channel.topic in of_interest or _last(channel.topic) in wanted):
                rows = np.flatnonzero(block.headers["channel"] == number).tolist()
                self._payloads.setdefault(channel.topic, []).extend(map(block.payload, rows))

    def accepted(self, topic: str) -> dict[Attempt, Observation]:
        """Return the accepted observations on ``topic``."""
        return accepted_by_attempt(messages.observation(m) for m in self.messages(topic))

    def messages(self, topic: str) -> Iterable[Any]:
        """Yield the plans or observations on ``topic`` as far as they are defined as ours."""
        with suppress(BagError, AttributeError, TypeError, ValueError):
            decoder = Decoder(self.channels[topic])
            for data in self._payloads.get(topic, ()):
                if (message := decoder.message(data)) is not None:
                    yield message


def _last(topic: str) -> str:
    return topic.rpartition("/")[2]


def accepted_by_attempt(observations: Iterable[Observation]) -> dict[Attempt, Observation]:
    """Return the accepted ones of some observations by what they observe."""
    return {(o.run, o.step, o.attempt): o for o in observations if o.accepted}
