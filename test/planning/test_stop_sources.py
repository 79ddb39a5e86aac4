"""Who stops a cell: a topic, diagnostics, their silence."""

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.planning.emergency_stop import StopSources
from rotcal_ros.planning.settings import SafetySettings

OK, WARN, ERROR, STALE = range(4)


def sources(topic="/safety/estop", **settings):
    return StopSources(SafetySettings(**settings), topic, now_s=100.0)


def test_the_topic_stops_while_it_is_true_and_nobody_has_to_publish_it():
    found = sources()
    assert found.reasons(1e6) == []
    found.receive(True, 101.0)
    assert found.reasons(1e6) == ["/safety/estop is true"]
    found.receive(False, 102.0)
    assert found.reasons(1e6) == []


@pytest.mark.parametrize("name", ["drive", "/cell/drive", "plc_node: drive", "/Robot/axes/drive"])
@pytest.mark.parametrize(("level", "word"), [(ERROR, "ERROR"), (STALE, "STALE")])
def test_a_status_of_a_configured_name_stops_until_it_is_good_again(name, level, word):
    found = sources(stop_on_diagnostics=("drive",))
    found.diagnose(name, level, "I2t", 101.0)
    assert found.reasons(101.0) == [f"{name} is in {word} on /diagnostics (I2t)"]
    found.diagnose(name, WARN, "warm", 102.0)
    assert found.reasons(102.0) == []


@pytest.mark.parametrize("name", ["overdrive", "drive/fan", "Drive"])
def test_other_names_stop_nothing(name):
    found = sources(stop_on_diagnostics=("drive",))
    found.diagnose(name, ERROR, "", 101.0)
    assert found.reasons(101.0) == []


def test_silence_stops_where_it_is_asked_for_from_the_start_on():
    found = sources(silent_s=1.0, stop_on_diagnostics=("drive",))
    assert found.reasons(101.0) == []
    silent = "has said nothing for 1 s (safety.silent_s)"
    assert found.reasons(101.1) == [f"/safety/estop {silent}", f"drive {silent}"]
    found.receive(False, 101.2)
    found.diagnose("drive", OK, "", 101.2)
    assert found.reasons(102.2) == []
    found.receive(True, 102.2)
    assert found.reasons(110.0) == ["/safety/estop is true", f"drive {silent}"]


def test_sources_that_share_the_end_of_their_name_do_not_speak_for_each_other():
    found = sources(topic="", silent_s=1.0, stop_on_diagnostics=("drive",))
    found.diagnose("plc: drive", ERROR, "I2t", 100.5)
    found.diagnose("spindle: drive", OK, "", 100.5)
    assert found.reasons(100.5) == ["plc: drive is in ERROR on /diagnostics (I2t)"]
    found.diagnose("plc: drive", OK, "", 100.5)
    assert found.reasons(100.5) == []
    found.diagnose("spindle: drive", OK, "", 101.6)
    assert found.reasons(101.6) == ["plc: drive has said nothing for 1 s (safety.silent_s)"]


def test_a_name_that_no_topic_can_bear_is_refused():
    with pytest.raises(ConfigurationError, match="emergency_stop: 'e stop' is not a name in ROS"):
        SafetySettings(emergency_stop="e stop")
    assert sources(topic="", silent_s=1.0).reasons(1e6) == []
