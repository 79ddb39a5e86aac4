"""Files in another order than that of time, topics of several channels: the same result."""

from __future__ import annotations

import random
import struct
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from rearranged import (
    CONFIGURATION,
    SECOND,
    START_NS,
    Kept,
    by_topic,
    changed,
    definition_of,
    run_messages,
    stamped,
    write_mcap,
    write_sqlite,
)

from rotcal_ros.bags.time_order import GOES_BACK, READ_BY
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.recordings.replay import read_recording

FIRST_NS = START_NS + 2_000_000
SET_UP = parse_configuration(CONFIGURATION)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ordered")
    found = read_recording(write_mcap(folder / "a.mcap", run_messages()))
    assert sum(o.accepted for o in found.observations) == 32
    assert found.warnings() == ()
    return found.observations


def in_windows(run: tuple[Kept, ...], seconds: float) -> list[Kept]:
    """Return the run as a program leaves it that writes its buffers topic by topic."""
    return sorted(run, key=lambda m: (int((m.log_ns - FIRST_NS) / SECOND / seconds), m.topic))


def of_the_writer(messages, *, published):
    """Return messages with the log times of a program that writes 1000 of them a second."""
    return changed(
        messages,
        lambda n, m: {
            "log_ns": FIRST_NS + n * 1_000_000,
            "publish_ns": m.publish_ns if published else FIRST_NS + n * 1_000_000,
        },
    )


ARRANGED = {
    "topic by topic": (by_topic, "read by log times"),
    "in buffers of 0.5 s": (lambda run: in_windows(run, 0.5), ""),
    "in buffers of 3 s": (lambda run: in_windows(run, 3.0), ""),
    "two channels in turn": (lambda run: changed(run, lambda n, _: {"channel": n % 2}), ""),
    "two channels, one after the other": (
        lambda run: changed(run, lambda n, _: {"channel": int(n > len(run) / 2)}), ""),
    "channel by channel": (
        lambda run: by_topic(changed(by_topic(run), lambda n, _: {"channel": n % 2})),
        "read by log times"),
    "all messages twice, by two recorders": (
        lambda run: [
            twice for m in run for twice in (m, replace(m, channel=1, log_ns=m.log_ns + 10**6))
        ], ""),
    "topic by topic, log times of the writer": (
        lambda run: of_the_writer(by_topic(run), published=True), "read by publish times"),
    "topic by topic, all times of the writer": (
        lambda run: of_the_writer(by_topic(run), published=False),
        "read by the stamps in their headers"),
    "topic by topic, one time for all": (
        lambda run: changed(by_topic(run), lambda *_: {"log_ns": FIRST_NS, "publish_ns": 0}),
        "read by the stamps in their headers"),
    "one time for all": (
        lambda run: changed(run, lambda *_: {"log_ns": FIRST_NS, "publish_ns": 0}), ""),
    "halves exchanged": (
        lambda run: [*run[len(run) // 2 :], *run[: len(run) // 2]], "read by log times"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "chunk_size"),
    [*((how, 30_000) for how in ARRANGED), *((how, 1 << 24) for how in list(ARRANGED)[::4])],
)
def test_the_observations_are_those_of_the_ordered_file(how, chunk_size, expected, tmp_path):
    arrange, words = ARRANGED[how]
    path = write_mcap(tmp_path / "a.mcap", arrange(run_messages()), chunk_size=chunk_size)
    found = read_recording(path)
    assert found.observations == expected
    assert [text for text in found.warnings() if words not in text or not words] == []
    assert len(found.warnings()) == bool(words)


@pytest.mark.parametrize("how", ["topic by topic", "two channels in turn", "channel by channel"])
def test_of_sqlite_too(how, expected, tmp_path):
    path = write_sqlite(tmp_path / "a.db3", ARRANGED[how][0](run_messages()))
    found = read_recording(path, configuration=SET_UP)
    assert (found.observations, found.warnings()) == (expected, ())


def test_times_of_the_writer_in_sqlite(expected, tmp_path):
    path = write_sqlite(
        tmp_path / "a.db3", of_the_writer(by_topic(run_messages()), published=False)
    )
    found = read_recording(path, configuration=SET_UP)
    assert found.observations == expected
    ((_, times),) = coded(*found.warnings())[READ_BY]
    assert times == "the stamps in their headers"


@pytest.mark.parametrize("numbered", [True, False])
def test_files_whose_names_are_exchanged(numbered, expected, tmp_path):
    half = len(run_messages()) // 2
    for number, part in enumerate((run_messages()[half:], run_messages()[:half])):
        messages = part if numbered else changed(part, lambda *_: {"sequence": 0})
        write_mcap(tmp_path / "bag" / f"bag_{number}.mcap", messages)
    assert read_recording(tmp_path / "bag").observations == expected


def test_messages_that_contradict_others_are_told(expected, tmp_path):
    """Two publishers of one topic: nobody knows which one is right."""
    ours = [m for m in run_messages() if m.topic.endswith(("tracer_length", "probe_point"))]
    at = {"tracer_length": -17, "probe_point": -56}  # bytes of a length, and of a position
    others = []
    for m in ours:
        end = at[m.topic.rpartition("/")[2]]
        (value,) = struct.unpack("<d", m.data[end : end + 8])
        data = m.data[:end] + struct.pack("<d", value + 15e-6) + m.data[end + 8 :]
        others.append(replace(m, data=data, channel=1, log_ns=m.log_ns + 1))
    both = sorted([*run_messages(), *others], key=lambda m: m.log_ns)
    found = read_recording(write_mcap(tmp_path / "a.mcap", both))
    assert found.observations == expected
    count = Counter(m.topic.rpartition("/")[2] for m in ours)
    assert [text.partition(" contradict ")[0] for text in found.warnings()] == [
        f"{count[role]} messages on {role}" for role in ("tracer_length", "probe_point")
    ]


@pytest.mark.parametrize(("every", "told"), [(16, False), (5, True)])
def test_steps_without_an_observation_are_told(every, told, tmp_path):
    """A few may be blocked; a fifth of them is worth a word."""
    orders = np.cumsum([m.topic.endswith("probe_target") for m in run_messages()])
    kept = [
        m
        for m, n in zip(run_messages(), orders, strict=True)
        if n % every or "tracer" not in m.topic
    ]
    words = read_recording(write_mcap(tmp_path / "a.mcap", kept)).warnings()[0]
    assert words.startswith("6 of 32 steps failed in every attempt, ") == told


def quarters(run, order):
    return [m for n in order for m in run[n * len(run) // 4 : (n + 1) * len(run) // 4]]


UNNUMBERED = {
    "halves exchanged": lambda run: quarters(run, (2, 3, 0, 1)),
    "quarters in another order": lambda run: quarters(run, (3, 1, 0, 2)),
    "in no order at all": lambda run: random.Random(8).sample(run, len(run)),
}


@pytest.mark.slow
@pytest.mark.parametrize("how", UNNUMBERED)
def test_without_numbers_the_stamps_tell(how, expected, tmp_path):
    messages = changed(
        UNNUMBERED[how](run_messages()), lambda _, m: {"sequence": 0, "publish_ns": m.log_ns}
    )
    found = read_recording(write_mcap(tmp_path / "a.mcap", messages, chunk_size=30_000))
    assert found.observations == expected
    (words,) = found.warnings()
    assert words.endswith("its messages were read by log times")


@pytest.mark.slow
@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("of_all", [True, False])
def test_a_clock_that_was_set_while_some_of_it_came_again(numbered, of_all, tmp_path):
    """Of the recorder alone, or of the whole machine: then the stamps go back as well."""
    messages = set_back(run_messages(), 5)
    if of_all:
        messages = [stamped(m, m.publish_ns - 5 * SECOND * (n > len(run_messages()) / 2))
                    for n, m in enumerate(messages)]  # fmt: skip
    if not numbered:
        messages = changed(messages, lambda *_: {"sequence": 0})
    found = read_recording(write_mcap(tmp_path / "a.mcap", messages))
    assert coded(found.warnings()[0])[GOES_BACK] == [(1, pytest.approx(5.0, abs=0.05))]
    assert sum(o.accepted for o in found.observations) >= 31


def set_back(messages, seconds):
    half = len(messages) / 2
    return changed(messages, lambda n, m: {"log_ns": m.log_ns - seconds * SECOND * (n > half)})


def test_a_clock_that_was_set_is_no_other_order(expected, tmp_path):
    found = read_recording(write_mcap(tmp_path / "a.mcap", set_back(run_messages(), 20)))
    assert found.observations == expected
    (words,) = found.warnings()
    assert words.startswith("log times go back 1 times, by up to 20.0 s: the recorder's clock")


@pytest.mark.parametrize(
    ("begin", "end"), [("", "\r\n"), ("\ufeff", "\n"), ("", "\r"), ("\ufeff", " \t\r\n")]
)
def test_definitions_of_windows_are_read(begin, end, expected, tmp_path):
    path = write_mcap(
        tmp_path / "a.mcap",
        run_messages(),
        definition=lambda name: begin + definition_of(name).replace("\n", end),
    )
    assert read_recording(path).observations == expected


def test_streams_without_any_true_time_are_told(tmp_path):
    """Bare numbers have no stamps: their order is not known when the log times do not."""
    bare = [
        Kept("/cell/joint_states", "std_msgs/msg/Float64", b"\0\1\0\0" + bytes(8), m.log_ns, 0)
        if m.topic.endswith("joint_states")
        else m
        for m in run_messages()
    ]
    path = write_mcap(tmp_path / "a.mcap", of_the_writer(by_topic(bare), published=False))
    assert "not all of its streams have valid times" in " ".join(read_recording(path).warnings())
