"""A bag that yields nothing says why, with exit code 3; a bad topic does not cost the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bag_samples as samples
import pytest
from bag_samples import START_NS, TYPES, Run, encode, serialised

from rotcal_ros.bags import names
from rotcal_ros.bags.dropouts import GAP, Dropout
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.observations import LengthStatus
from rotcal_ros.recordings.missing_data import ObservationWindow, describe_dropouts, match_dropouts
from rotcal_ros.recordings.replay import Recording, read_recording
from rotcal_ros.recordings.topics import Topics


def temperature() -> bytes:
    return serialised(TYPES[names.TEMPERATURE], stamp_ns=START_NS, temperature=20.0, variance=0.0)


def bag(folder: Path, role: str, data: bytes, definition: str | None = None) -> Path:
    """Write one message of one topic; ``definition`` in the place of the true one."""
    text = samples.STORE.generate_msgdef(TYPES[role], ros_version=2)[0]
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        writer.attach(names.CONFIGURATION, "application/yaml", samples.CONFIGURATION.encode())
        channel = writer.channel(
            f"/cell/{role}", TYPES[role], text if definition is None else definition
        )
        writer.write(channel, data, START_NS, START_NS)
    return folder


def reason(recording: Recording) -> str:
    with pytest.raises(DataError) as nothing:
        recording.solve()
    assert nothing.value.exit_code == 3
    text = str(nothing.value)
    assert "\n" not in text
    return text


def test_missing_topics_are_named_with_those_that_are_there(tmp_path: Path) -> None:
    text = reason(read_recording(bag(tmp_path / "bag", names.TEMPERATURE, temperature())))
    assert "nothing was read on tracer_length, joint_states, probe_point" in text
    assert "its topics are /cell/temperature" in text


def test_another_namespace_is_named(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", names.TEMPERATURE, temperature())
    text = reason(read_recording(folder, topics=Topics("/other")))
    assert "temperature" in text.partition("its topics are")[0]
    assert "--namespace" in text


@pytest.mark.parametrize("definition", ["float64 x\nrotcal_msgs/Tra", "TracerLength x\n"])
def test_a_definition_that_cannot_be_used_is_the_reason(tmp_path: Path, definition: str) -> None:
    sample = samples.TracerSample(START_NS, 0, 0.1, 1e-7, LengthStatus.OK)
    ((_, data),) = encode(sample)
    recording = read_recording(bag(tmp_path / "bag", names.TRACER_LENGTH, data, definition))
    text = reason(recording)
    assert "/cell/tracer_length" in text
    assert any("/cell/tracer_length" in warning for warning in recording.warnings())


def test_messages_that_cannot_be_decoded_are_the_reason(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", names.TRACER_LENGTH, b"\7\7\0\0nothing")
    assert "/cell/tracer_length: 1 messages cannot be decoded" in reason(read_recording(folder))


@pytest.mark.parametrize("role", sorted(TYPES))
@pytest.mark.parametrize("definition", ["uint8 x\n", "float64 header\nfloat64 position\n"])
def test_a_type_with_other_fields_is_named(tmp_path: Path, role: str, definition: str) -> None:
    """Only the empty definition says nothing of fields; each role names its own topic and type."""
    folder = bag(tmp_path / "bag", role, b"\0\1\0\0" + bytes(16), definition)
    try:
        recording = read_recording(folder)
    except BagError as error:
        text = str(error)
        assert f"topic /cell/{role}: {TYPES[role]}" in text
        assert "\n" not in text
    else:
        assert role in reason(recording)


def test_no_recorded_observations(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", names.TEMPERATURE, temperature())
    assert "no topic observation holds any" in reason(read_recording(folder, "observations"))


def test_the_commonest_reason_of_rejections(tmp_path: Path, simulated_run: Run) -> None:
    accepted = simulated_run.observations[0]
    reasons = ("too few readings: 3", "too few readings: 4", "the table moved")
    folder = tmp_path / "bag"
    writer, channels = samples.open_writer(folder)
    with writer:
        for number, text in enumerate(reasons):
            rejected = replace(accepted, step=number, accepted=False, reason=text)
            for role, data in encode(rejected):
                writer.write(channels[role], data, number, number)
    text = reason(read_recording(folder, "observations"))
    assert "all 3 were rejected, 2 of 3 like this: too few readings: 4" in text


def test_a_bad_topic_does_not_cost_the_others(tmp_path: Path, simulated_run: Run) -> None:
    """A second topic nobody needs has a definition that contains itself."""
    writer, channels = samples.open_writer(tmp_path / "bag")
    with writer:
        bad = writer.channel("/cell/air_pressure", "a/msg/B", "B x\n")
        writer.write(bad, b"\0\1\0\0", START_NS, START_NS)
        for number, record in enumerate(simulated_run.records):
            for role, data in encode(record):
                writer.write(channels[role], data, START_NS + number, START_NS + number)
    recording = read_recording(tmp_path / "bag")
    assert recording.observations == tuple(simulated_run.observations)
    assert any("a/msg/B contains itself" in warning for warning in recording.warnings())


SECOND = 10**9


def windows(*accepted):
    """Return windows of half a second, one beginning at each second."""
    return [
        ObservationWindow(step, step * SECOND, step * SECOND + SECOND // 2)
        for step, good in enumerate(accepted)
        if good
    ]


def file(*spans):
    return SimpleNamespace(
        dropouts=tuple(
            Dropout("/cell/a", int(begin * SECOND), int(end * SECOND), 1, GAP)
            for begin, end in spans
        )
    )


@pytest.mark.parametrize(
    ("span", "steps"),
    [((0.6, 0.9), ()), ((0.4, 0.45), (0,)), ((0.5, 1.0), (0, 1)), ((1.2, 9.0), (1, 3)),
     ((2.1, 2.2), ())],
)  # fmt: skip
def test_the_steps_are_those_of_accepted_windows(span, steps):
    (found,) = match_dropouts([file(span)], windows(True, True, False, True))
    assert found.steps == steps
    assert found.to_dict()["steps"] == list(steps)


def test_dropouts_of_all_files_come_in_the_order_of_time():
    found = match_dropouts([file((3.0, 3.1)), file((1.0, 1.1), (2.0, 2.1))], ())
    assert [f.dropout.from_ns // SECOND for f in found] == [1, 2, 3]


def test_words_name_few_steps_and_say_how_many_dropouts_there_are():
    everything = match_dropouts([file((0, 99))], windows(*[True] * 7))
    assert describe_dropouts(everything)[0].endswith(f"{GAP}; steps 0 to 6, 7 in all")
    (one,) = describe_dropouts(match_dropouts([file((2.0, 2.1))], windows(*[True] * 7)))
    assert one.endswith("; step 2")
    many = match_dropouts([file(*((n, n) for n in range(25)))], ())
    assert describe_dropouts(many)[-1] == "and 5 more dropouts"
