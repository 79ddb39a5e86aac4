"""Topics with other names, by remapping and by the group topics: live, and from the bag alone."""

import json

import pytest

from rotcal_ros.bags import names
from rotcal_ros.catalogue.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.results import Result

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

OTHER = {
    names.TRACER_LENGTH: "/leica/length",
    names.TEMPERATURE: "/cell/hall/air",
    names.JOINT_STATES: "/drive/states",
    names.TABLE_ANGLE: "/drive/angle",
    names.OBSERVATION: "/cell/seen",
}
DRIVE = ("-r", "joint_states:=/drive/states", "-r", "table_angle:=/drive/angle")
SEEN = ("-r", "observation:=/cell/seen")


def test_names_of_goal_and_remapping_are_heard_recorded_and_read_again(cell):
    live = cell("planner.preflight_timeout_s=5.0")
    named = live.folder / "named.yaml"
    given = ("topics.tracer_length=/leica/length", "topics.temperature=hall/air")
    named.write_text(changed(read_configuration(live.file), given).text)
    live.start("recorder")  # follows the others
    live.start("capture", arguments=(*DRIVE, *SEEN))
    live.start("planner", arguments=("-r", "table_angle:=/drive/angle", *SEEN))
    live.start("solver", arguments=SEEN)
    live.start("simulated_cell", file=named, arguments=DRIVE)

    # without the group nobody listens there, and that is said by the names in question
    failed = live.client("first").result()
    assert failed["error_code"] == 602
    assert "nobody publishes /cell/tracer_length" in failed["error_msg"]
    assert "/cell/joint_states" not in failed["error_msg"]

    outcome = live.client("second", configuration=named).result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert len(recording.recorded) > 50
    text = (live.session / "result.json").read_text()
    assert recording.solve().to_json() == text
    assert Result.from_dict(json.loads(text)).verdict == outcome["verdict"]
    topics = recording.verdicts[0].topics
    assert all(topics[topic].messages > 0 for topic in OTHER.values())
    assert not {f"/cell/{role}" for role in OTHER} & topics.keys()
    assert not any(recording.verdicts[0].losses_recorded.values())
