"""What clocks that differ spoil is what the live capture said, however its estimate came about."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from bag_samples import CONFIGURATION, START_NS, Run, encode, open_writer

from rotcal_ros.bags import names
from rotcal_ros.capture.stamp_offsets import OffsetLimits, StampOffsets
from rotcal_ros.foundation.observations import (
    Command,
    Observation,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, parse_configuration
from rotcal_ros.recordings.replay import read_recording

SECOND = 1_000_000_000
LIMIT_S = 1.0
SECONDS = 15
SETUP = changed(parse_configuration(CONFIGURATION), [f"capture.stamp_offset_s={LIMIT_S}"])
TOPICS = {
    TracerSample: names.TRACER_LENGTH,
    TableSample: names.JOINT_STATES,
    ProbeSample: names.PROBE_POINT,
}


@dataclass
class Live:
    """A live capture that gets the tracer ``late_s`` behind its stamps, negative: ahead of them.

    It is deaf to when the tracer comes before ``deaf_s``; its recorder gets the tracer
    ``recorded_late_s`` behind the others.
    """

    late_s: float
    recorded_late_s: float
    deaf_s: float = 0.0
    capture: Any = field(default_factory=lambda: prepare(SETUP).capture())
    offsets: StampOffsets = field(
        default_factory=lambda: StampOffsets(OffsetLimits.of(SETUP.capture))
    )

    def received(self, record: Any) -> int:
        return came_ns(record, self.late_s)

    def logged(self, record: Any) -> int:
        return came_ns(record, self.recorded_late_s)

    def observed(self, record: Any) -> list[Observation]:
        topic, received_ns = TOPICS.get(type(record)), self.received(record)
        deaf = topic == names.TRACER_LENGTH and received_ns < START_NS + self.deaf_s * SECOND
        if topic and not deaf:
            self.offsets.note(topic, record.stamp_ns, received_ns)
        return [*map(self.offsets.check_clocks, self.capture.feed(record))]


def came_ns(record: Any, late_s: float) -> int:
    return int(record.stamp_ns) + round(late_s * SECOND) * isinstance(record, TracerSample)


def record_live(
    folder: Path, run: Run, live: Live, *, recorded: bool = True
) -> tuple[Observation, ...]:
    """Write the streams of a run as they come, and the observations; return these."""
    streams = [r for r in run.records if not isinstance(r, Command | Observation)]
    first = [r for r in streams if live.received(r) < START_NS + SECONDS * SECOND]
    found: list[Observation] = []
    writer, channels = open_writer(folder, configuration=SETUP.text)
    with writer:
        for record in sorted(first, key=live.received):
            observed = live.observed(record)
            found += observed
            for written in (record, *(observed if recorded else ())):
                for role, data in encode(written):
                    writer.write(channels[role], data, live.logged(record), live.logged(record))
    return tuple(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("late_s", "recorded_late_s", "deaf_s"),
    [(1.5, 1.5, 0.0), (1.5, 1.5, 12.0), (1.5, 0.0, 0.0), (-0.8, -0.8, 0.0), (-0.8, 0.0, 0.0)],
)
def test_offline_rejects_what_live_rejected_and_nothing_else(
    tmp_path: Path, simulated_run: Run, late_s: float, recorded_late_s: float, deaf_s: float
) -> None:
    live = Live(late_s, recorded_late_s, deaf_s)
    expected = record_live(tmp_path / "bag", simulated_run, live)
    accepted = [o for o in expected if o.accepted]
    assert len(accepted) == (3 if deaf_s else 0)
    assert len(expected) == 4
    assert all("by the times of arrival" in o.reason for o in expected if not o.accepted)
    recording = read_recording(tmp_path / "bag")
    assert recording.observations == recording.recorded == expected
    assert recording.same_as_recorded


@pytest.mark.slow
def test_where_nothing_was_recorded_the_bag_tells(tmp_path: Path, simulated_run: Run) -> None:
    record_live(tmp_path / "bag", simulated_run, Live(1.5, 1.5), recorded=False)
    recording = read_recording(tmp_path / "bag")
    assert len(recording.observations) == 4
    assert not any(o.accepted for o in recording.observations)
    record_live(tmp_path / "sound", simulated_run, Live(0.0, 0.0), recorded=False)
    recording = read_recording(tmp_path / "sound")
    assert all(o.accepted for o in recording.observations)


def test_with_another_limit_the_bag_tells(tmp_path: Path, simulated_run: Run) -> None:
    live = Live(0.15, 0.15, offsets=StampOffsets(OffsetLimits(0.1)))
    assert not any(o.accepted for o in record_live(tmp_path / "bag", simulated_run, live))
    lenient = changed(SETUP, ["capture.stamp_offset_s=2.0"])
    recording = read_recording(tmp_path / "bag", configuration=lenient)
    assert all(o.accepted for o in recording.observations)
