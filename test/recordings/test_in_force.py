"""Which table was in force, as bag and configuration state it: known, unknown, contradictory."""

from dataclasses import replace
from pathlib import Path

import pytest
from bag_samples import START_NS, STORE, encode, open_writer, serialised

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.in_force import agreed_state, check_in_force, describe_contradiction
from rotcal_ros.foundation.results import Result
from rotcal_ros.planning.settings import CellSettings
from rotcal_ros.recordings.replay import read_recording

KIND = "rotcal_msgs/msg/TableInForce"
BAG = Path(__file__).parents[2] / "examples" / "data" / "ball_plate_bag"
ONE, OTHER = "a" * 64, "b" * 64


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ((), "unknown"),
        (("unknown", ""), "unknown"),
        (("unknown", "none"), "unknown"),  # who announced it could not know: no proof of nothing
        (("none", "none", ""), "none"),
        ((ONE, "unknown"), ONE),
        ((ONE, ONE, "unknown"), ONE),
        ((ONE, "none"), "unknown"),
        ((ONE, OTHER), "unknown"),
    ],
)
def test_only_what_all_agree_on_is_known(states, expected):
    assert agreed_state(states) == expected
    several = len(set(states) - {"unknown", ""}) > 1
    assert bool(describe_contradiction(states)) == (several or set(states) == {"none", "unknown"})


def test_a_bag_without_this_knowledge_reads_as_unknown_and_keeps_its_bits():
    recording = read_recording(BAG)
    assert recording.announced == frozenset()
    plain = recording.solve()
    assert plain.measured_on == "unknown"
    assert "measured_on" not in plain.to_dict()
    known = replace(recording, announced=frozenset({ONE})).solve()
    assert known.measured_on == ONE
    assert Result.from_dict(known.to_dict()).measured_on == ONE
    assert {k: v for k, v in known.to_dict().items() if k != "measured_on"} == plain.to_dict()
    both = replace(recording, announced=frozenset({ONE, "none"}))
    assert both.solve().measured_on == "unknown"
    assert any("more than one table was in force" in text for text in both.warnings())


def announcing_bag(folder, run, states, axes=("C",)):
    """A bag of a run during which the cell announced ``states``, one after the other, of axes."""
    writer, channels = open_writer(folder)
    with writer:
        definition = STORE.generate_msgdef(KIND, ros_version=2)[0]
        topic = writer.channel(f"/cell/{names.TABLE_IN_FORCE}", KIND, definition)
        for number, state in enumerate(states):
            for axis in axes[number % len(axes) :][:1]:
                data = serialised(KIND, stamp_ns=START_NS + number, axis=axis, in_force=state)
                writer.write(topic, data, START_NS + number, START_NS + number)
        for number, record in enumerate(run.records):
            for role, data in encode(record):
                writer.write(channels[role], data, START_NS + number, START_NS + number)
    return read_recording(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("states", "expected", "words"),
    [
        ((), "unknown", ""),
        (("unknown",), "unknown", ""),
        (("none", "none"), "none", ""),
        (("unknown", ONE), ONE, ""),
        ((ONE, OTHER), "unknown", "more than one table was in force"),
        ((ONE, "yes"), "unknown", "'yes', which is not a table"),
    ],
)
def test_what_a_cell_announced_is_read_from_the_bag(
    tmp_path, simulated_run, states, expected, words
):
    recording = announcing_bag(tmp_path / "bag", simulated_run, states)
    assert recording.announced == frozenset(states)
    result = recording.solve()
    assert result.measured_on == expected
    assert Result.from_dict(result.to_dict()).measured_on == expected
    about = [text for text in recording.warnings() if "in force" in text]
    assert len(about) == bool(words)
    assert all(words in text for text in about)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("states", "axes", "expected"),
    [
        ((ONE, OTHER), ("C", "B"), ONE),  # two tables, one of them that of another axis
        (("none",), ("B",), "unknown"),
        ((ONE, OTHER), ("", "B"), ONE),
    ],
)
def test_what_is_announced_of_another_axis_does_not_count(
    tmp_path, simulated_run, states, axes, expected
):
    recording = announcing_bag(tmp_path / "bag", simulated_run, states, axes)
    result = recording.solve()
    assert result.measured_on == expected
    assert any("the table in force of axis B: ignored for axis C" in w for w in result.warnings)


@pytest.mark.slow
def test_the_setting_none_is_no_match_for_a_bridge_that_cannot_tell(tmp_path, simulated_run):
    recording = announcing_bag(tmp_path / "bag", simulated_run, ("unknown",))
    configuration = recording.configuration
    stated = replace(
        recording.calibration,
        configuration=replace(
            configuration, cell=replace(configuration.cell, table_in_force="none")
        ),
    )
    recording = replace(recording, calibration=stated)
    assert recording.solve().measured_on == "unknown"
    assert any("'none' was stated" in text for text in recording.warnings())
    assert replace(recording, announced=frozenset()).solve().measured_on == "none"


@pytest.mark.parametrize("state", ["", "yes", "A" * 64, "a" * 63])
def test_a_misspelt_state_is_refused(state):
    with pytest.raises(ConfigurationError, match="expected the SHA-256"):
        check_in_force(state)
    with pytest.raises(ConfigurationError):
        CellSettings(table_in_force=state)


def test_a_damaged_result_is_refused():
    data = read_recording(BAG).solve().to_dict()
    with pytest.raises((DataError, ConfigurationError), match="table in force"):
        Result.from_dict({**data, "measured_on": "yes"})
