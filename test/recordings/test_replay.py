"""Offline equals live, also for cut-off, split and unordered bags."""

from __future__ import annotations

import hashlib
import random
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_samples import (
    CONFIGURATION,
    START_NS,
    STORE,
    TYPES,
    Run,
    encode,
    open_writer,
    serialised,
    write_run,
    writer_settings,
)
from coded import coded

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.storage_scan import losses_in_words, session_losses
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.observations import LengthStatus, Observation, TracerSample
from rotcal_ros.methods.configuration import parse_configuration, read_configuration, read_policy
from rotcal_ros.recordings.replay import CAPTURED_OTHERWISE, read_recording
from rotcal_ros.recordings.summary import summarise_bag
from rotcal_ros.recordings.topics import Topics

GOLDEN = Path(__file__).parents[1] / "golden"


def test_streams_give_the_live_observations_to_the_last_bit(
    run_bag: Path, simulated_run: Run
) -> None:
    recording = read_recording(run_bag)
    assert len(recording.observations) == 32
    assert recording.observations == tuple(simulated_run.observations)
    assert recording.recorded == tuple(simulated_run.observations)
    assert recording.same_as_recorded
    assert recording.warnings() == ()
    assert recording.calibration.configuration.text == CONFIGURATION
    tracer = sum(isinstance(record, TracerSample) for record in simulated_run.records)
    assert recording.counts["tracer"] == {"received": tracer}
    digest = hashlib.sha256((run_bag / "run_0.mcap").read_bytes()).hexdigest()
    assert recording.sha256 == {"run_0.mcap": digest}


def test_recorded_observations_are_taken_as_they_are(run_bag: Path, simulated_run: Run) -> None:
    recording = read_recording(run_bag, "observations")
    assert recording.observations == tuple(simulated_run.observations)
    assert recording.counts == {}


def test_given_configuration_wins(run_bag: Path) -> None:
    text = CONFIGURATION.replace("window_samples: 30", "window_samples: 20")
    assert text != CONFIGURATION
    recording = read_recording(run_bag, configuration=parse_configuration(text))
    assert {o.n_samples for o in recording.observations} == {20}
    assert not recording.same_as_recorded
    assert CAPTURED_OTHERWISE in coded(*recording.warnings())


@pytest.mark.parametrize("method", ["tracer", "ball_plate", "plane_mirror"])
@pytest.mark.parametrize("other", ["tracer", "ball_plate", "plane_mirror", "tracer_six"])
def test_the_set_up_of_another_method_is_refused(method: str, other: str) -> None:
    given = read_configuration(GOLDEN / other / "table" / "setup.yaml")
    if method == other:
        assert read_recording(GOLDEN / method / "bag", configuration=given).observations
        return
    with pytest.raises(DataError, match=f"was recorded with .*{method}.* sets up {other}"):
        read_recording(GOLDEN / method / "bag", configuration=given)


def test_what_another_set_up_does_not_find_again_differs_and_nothing_breaks(run_bag: Path) -> None:
    """A set-up whose capture never sees the table at rest: no observation, and no traceback."""
    text = CONFIGURATION.replace("window_samples: 30", "window_samples: 30000")
    recording = read_recording(run_bag, configuration=parse_configuration(text))
    assert not [o for o in recording.observations if o.accepted]
    assert CAPTURED_OTHERWISE in coded(*recording.warnings())


def test_truncated_bag_gives_the_first_observations(
    run_bag: Path, simulated_run: Run, tmp_path: Path
) -> None:
    data = (run_bag / "run_0.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: len(data) // 2])
    recording = read_recording(path)
    n = len(recording.observations)
    assert 5 < n < 32
    assert recording.observations == tuple(simulated_run.observations[:n])
    assert [v.state for v in recording.verdicts] == ["truncated"]
    assert "truncated at byte" in recording.warnings()[0]


@pytest.mark.slow
def test_split_session_is_one(simulated_run: Run, tmp_path: Path) -> None:
    settings = writer_settings(split_bytes=200_000, chunk_bytes=20_000)
    write_run(tmp_path / "split", simulated_run, settings, tick_every=100)
    assert len(list((tmp_path / "split").glob("*.mcap"))) > 3
    (tmp_path / "split" / "metadata.yaml").unlink()
    recording = read_recording(tmp_path / "split")
    assert recording.observations == tuple(simulated_run.observations)


def test_order_between_streams_does_not_matter(simulated_run: Run, tmp_path: Path) -> None:
    """A recorder may get the streams in another order than the live capture did."""
    chance = random.Random(3)
    delays = {kind: chance.uniform(0, 40) for kind in (TracerSample,)}
    shuffled = sorted(
        enumerate(simulated_run.records), key=lambda pair: pair[0] + delays.get(type(pair[1]), 0.0)
    )
    run = Run([record for _, record in shuffled], simulated_run.observations)
    write_run(tmp_path / "other", run)
    assert read_recording(tmp_path / "other").observations == tuple(simulated_run.observations)


def test_configuration_from_the_plan_topic(simulated_run: Run, tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    writer.close()
    shutil.rmtree(tmp_path / "bag")
    writer, channels = open_writer(tmp_path / "bag", configuration="not: this")
    with writer:
        data = serialised(
            "rotcal_msgs/msg/CalibrationPlan", stamp_ns=START_NS, plan_id="", method="",
            configuration=CONFIGURATION, total_steps=32, start_index=0, run=0,
        )  # fmt: skip
        writer.write(channels[names.PLAN], data, START_NS, START_NS)
    # the attachment comes first; without one the topic is used
    with pytest.raises(ConfigurationError, match=r"bag_0\.mcap"):
        read_recording(tmp_path / "bag")
    path = tmp_path / "bag" / "bag_0.mcap"
    path.write_bytes(path.read_bytes().replace(b"configuration.yaml", b"configuration.yamX"))
    assert read_recording(path).calibration.configuration.text == CONFIGURATION


def test_a_simulation_stays_one_in_an_old_bag(run_bag: Path, tmp_path: Path) -> None:
    """Settings that nobody knows today: the group ``simulation`` and the identity are read."""
    real = CONFIGURATION[: CONFIGURATION.index("    simulation:")]
    given = parse_configuration(real)
    assert not given.simulated
    assert read_recording(run_bag, configuration=given).configuration.simulated
    sample = TracerSample(START_NS, 1, 0.5, 1e-7, LengthStatus.OK)
    known = "    identity: {item: table, serial: '7'}\n"
    for bag, text, note in (
        ("old", CONFIGURATION.replace("window_samples", "window_of_old") + known, {}),
        ("noted", "not: this", {"item": "table", "simulated": "true"}),
    ):
        writer, channels = open_writer(tmp_path / bag, configuration=text)
        with writer:
            if note:
                writer.note(names.SUBJECT, note)
            data = encode(sample)[0][1]
            writer.write(channels[names.TRACER_LENGTH], data, START_NS, START_NS)
        found = read_recording(tmp_path / bag, configuration=given).configuration
        assert (found.simulated, found.identity.item) == (True, "table")


def test_a_policy_in_a_comment_is_none() -> None:
    assert read_policy("# until_goal is not meant\n" + CONFIGURATION) == "as_listed"
    assert read_policy(CONFIGURATION + "    planner: {policy: until_goal}\n") == "until_goal"
    assert read_policy("not: this") == "as_listed"


def test_two_cells_in_one_bag_must_be_told_apart(simulated_run: Run, tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    with writer:
        kind = TYPES[names.TRACER_LENGTH]
        definition = STORE.generate_msgdef(kind, ros_version=2)[0]
        other = writer.channel("/cell2/tracer_length", kind, definition)
        tracer = next(r for r in simulated_run.records if isinstance(r, TracerSample))
        for channel in (channels[names.TRACER_LENGTH], other):
            writer.write(channel, encode(tracer)[0][1], START_NS, START_NS)
    with pytest.raises(BagError, match="two topics of the bag are called tracer_length"):
        read_recording(tmp_path / "bag")
    assert read_recording(tmp_path / "bag", topics=Topics("/cell")).observations == ()


def test_renamed_topics(simulated_run: Run, tmp_path: Path) -> None:
    topics = Topics(renamed={names.TRACER_LENGTH: "/interferometer/reading"})
    assert topics.role("/interferometer/reading") == names.TRACER_LENGTH
    assert topics.role("/cell/tracer_length") is None
    assert topics.role("/cell/probe_point") == names.PROBE_POINT
    assert topics.role("/rosout") is None


def test_messages_that_cannot_be_decoded_are_counted(simulated_run: Run, tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    with writer:
        for record in simulated_run.records[:2000]:
            for role, data in encode(record):
                writer.write(channels[role], data, START_NS, START_NS)
        for role in (names.TRACER_LENGTH, names.PROBE_POINT, names.OBSERVATION):
            writer.write(channels[role], b"\0\1\0\0nonsense", START_NS, START_NS)
    recording = read_recording(tmp_path / "bag")
    assert recording.broken == {
        f"/cell/{role}": 1 for role in (names.TRACER_LENGTH, names.PROBE_POINT, names.OBSERVATION)
    }


def test_losses_counted_live_are_told(simulated_run: Run, tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    with writer:
        writer.write(channels[names.TRACER_LENGTH], encode(simulated_run.records[1])[0][1], 1, 1)
        writer.note(names.LOSSES, {"tracer_length: queue full": 4, "probe_point: gap": 0})
    assert read_recording(tmp_path / "bag").warnings() == (
        "4 lost live (tracer_length: queue full)",
    )


def test_counters_of_a_split_session_count_once_and_those_of_a_later_run_besides(tmp_path):
    data, counter = encode(TracerSample(1, 0, 0.5, 1e-7, LengthStatus.OK))[0][1], "gap /a"
    for run, lost in ((0, 3), (1, 2)):
        earlier = InterruptedSession.read(tmp_path / "bag").files if run else None
        settings = WriterSettings(min_free_bytes=0, split_bytes=1)
        with BagWriter(tmp_path / "bag", settings, earlier=earlier) as writer:
            writer.note(names.RUN, {"number": run})
            channel = writer.channel("/a", "demo_msgs/msg/Blob", "uint8[] data\n")
            for number in range(3):
                writer.note(names.LOSSES, {counter: lost, f"{names.SILENT} /b": run})
                writer.write(channel, data, number, number)
                writer.sync()
    verdicts = check_files(bag_files(tmp_path / "bag"))
    assert len(verdicts) > 4
    losses = session_losses(verdicts)
    assert losses == {counter: 5, f"{names.SILENT} /b": 1}
    assert losses_in_words(losses) == ("5 lost live (gap /a)", "/b fell silent (1 times)")


@pytest.mark.slow
def test_an_observation_that_nobody_lived_to_record_is_no_difference(
    simulated_run: Run, tmp_path: Path
) -> None:
    whole, last = simulated_run.records, simulated_run.observations[-1]
    write_run(tmp_path / "killed", Run([r for r in whole if r is not last]))
    recording = read_recording(tmp_path / "killed")
    assert len(recording.observations) == len(recording.recorded) + 1
    assert recording.same_as_recorded
    middle = simulated_run.observations[5]
    write_run(tmp_path / "gap", Run([r for r in whole if r is not middle]))
    assert not read_recording(tmp_path / "gap").same_as_recorded
    other = replace(last, mean=(last.mean[0] + 1e-9,))
    write_run(tmp_path / "other", Run([other if r is last else r for r in whole]))
    assert not read_recording(tmp_path / "other").same_as_recorded


def test_bag_without_messages(tmp_path: Path) -> None:
    writer, _ = open_writer(tmp_path / "bag")
    writer.close()
    with pytest.raises(BagError, match="holds no messages"):
        read_recording(tmp_path / "bag")


def test_progress_ends_at_the_size_of_the_bag(run_bag: Path) -> None:
    calls: list[tuple[int, int]] = []
    read_recording(run_bag, progress=lambda done, total: calls.append((done, total)))
    size = (run_bag / "run_0.mcap").stat().st_size
    assert {total for _, total in calls} == {size}
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert calls[-1][0] <= size


def test_attempts_are_kept_apart(simulated_run: Run, tmp_path: Path) -> None:
    """The bag gives every attempt; the last accepted one counts, as live."""
    first: Any = simulated_run.observations[0]
    assert isinstance(first, Observation)
    again = replace(first, attempt=1, mean=(first.mean[0] + 1e-6,))
    run = Run([first, again, replace(first, attempt=2, accepted=False, reason="drift")])
    write_run(tmp_path / "bag", run)
    recording = read_recording(tmp_path / "bag", "observations")
    assert recording.observations == tuple(run.records)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["noted", "planned", "asked"])
def test_other_names_are_read_without_arguments(simulated_run, run_bag, tmp_path, how):
    settings = WriterSettings(min_free_bytes=0)
    text = CONFIGURATION
    if how == "planned":
        text += "    topics: {tracer_length: laser/length}\n"
    with BagWriter(tmp_path / "bag", settings) as writer:
        if how == "noted":
            writer.note(names.TOPICS, {names.TRACER_LENGTH: "/cell/laser/length", "x": "/y"})
        writer.attach(names.CONFIGURATION, "application/yaml", text.encode())
        other = {names.TRACER_LENGTH: "/cell/laser/length"}
        channels = {
            role: writer.channel(
                other.get(role, f"/cell/{role}"), kind, STORE.generate_msgdef(kind)[0]
            )
            for role, kind in TYPES.items()
        }
        for number, record in enumerate(simulated_run.records):
            time_ns = START_NS + number * 1_000_000
            for role, data in encode(record):
                writer.write(channels[role], data, time_ns, time_ns - 1000)
    asked = {names.TRACER_LENGTH: "/cell/laser/length"} if how == "asked" else {}
    recording = read_recording(tmp_path / "bag", topics=Topics(renamed=asked))
    assert recording.observations == read_recording(run_bag).observations
    assert recording.same_as_recorded


@pytest.mark.parametrize("where", ["one attachment twice", "attachment and plan", "two plans"])
def test_two_configurations_that_differ_are_refused_unless_one_is_given(
    simulated_run: Run, tmp_path: Path, where: str
) -> None:
    changed = CONFIGURATION.replace("window_samples: 30", "window_samples: 20")
    line = next(n for n, text in enumerate(CONFIGURATION.splitlines(), 1) if "window_sa" in text)
    first = "x: 1" if where == "two plans" else CONFIGURATION
    writer, channels = open_writer(tmp_path / "bag", configuration=first)
    with writer:
        if where == "one attachment twice":
            writer.attach(names.CONFIGURATION, "application/yaml", changed.encode())
        plans = {"attachment and plan": [changed], "two plans": [CONFIGURATION, changed]}
        for number, text in enumerate(plans.get(where, [CONFIGURATION])):
            data = serialised(
                "rotcal_msgs/msg/CalibrationPlan", stamp_ns=START_NS, plan_id="", method="",
                configuration=text, total_steps=32, start_index=0, run=0,
            )  # fmt: skip
            writer.write(channels[names.PLAN], data, START_NS + number, START_NS + number)
    path = tmp_path / "bag" / "bag_0.mcap"
    if where == "two plans":  # without an attachment
        path.write_bytes(path.read_bytes().replace(b"configuration.yaml", b"configuration.yamX"))
    with pytest.raises(BagError) as refused:
        read_recording(path)
    assert "holds 2 configurations that differ" in str(refused.value)
    assert f"line {line} is " in str(refused.value)
    assert "window_samples: 30" in str(refused.value)
    assert "--setup" in str(refused.value)
    if where == "one attachment twice":  # a summary reads no messages
        told = summarise_bag(path)
        assert told.contradiction == str(refused.value)
        assert told.to_dict()["method"] is None
    given = parse_configuration(CONFIGURATION)
    assert read_recording(path, configuration=given).configuration.text == CONFIGURATION
