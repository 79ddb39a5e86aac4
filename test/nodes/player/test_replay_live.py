"""Topics with other names, recorded and read; and the same bag replayed to live nodes."""

import json
import re
import sys

import pytest
import warm

from rotcal_ros.bags import names
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording

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


def rotcal(*arguments):
    return warm.run(
        [sys.executable, "-m", "rotcal_ros.cli.main", *map(str, arguments)],
        timeout=load_scaled_timeout(100.0),
    )


@pytest.mark.slow
def test_other_names_are_heard_recorded_read_again_and_replayed(cell, monkeypatch):
    live = cell("planner.preflight_timeout_s=1.5")
    for name, value in live.processes.environment.items():
        if name != "ROTCAL_SUPERVISOR":
            monkeypatch.setenv(name, value)
    named = live.folder / "named.yaml"
    given = (
        "topics.tracer_length=/leica/length", "topics.temperature=hall/air",
        "planner.preflight_timeout_s=30.0",
    )  # fmt: skip
    named.write_text(changed(read_configuration(live.file), given).text)
    live.start("recorder")  # follows the others
    live.start("capture", arguments=(*DRIVE, *SEEN))
    live.start("planner", arguments=("-r", "table_angle:=/drive/angle", *SEEN))
    live.start("solver", arguments=SEEN)
    live.start("simulated_cell", file=named, arguments=DRIVE)

    # without the group nobody listens there, and that is said by the names in question
    failed = live.client("first").result()
    assert failed["error_code"] == 602, failed["error_msg"]
    assert "no node publishes /cell/tracer_length" in failed["error_msg"]
    assert "/cell/joint_states" not in failed["error_msg"]

    outcome = live.client("second", configuration=named).result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert len(recording.recorded) > 50
    recorded = (live.session / "result.json").read_text()
    assert recording.solve().to_json() == recorded
    topics = recording.verdicts[0].topics
    assert all(topics[topic].messages > 0 for topic in OTHER.values())
    assert not {f"/cell/{role}" for role in OTHER} & topics.keys()
    assert not any(recording.verdicts[0].losses_recorded.values())

    # with the machine still there nothing is replayed; without it, live nodes say the same again
    refused = rotcal("replay", live.bag)
    assert refused.returncode == 2
    found = re.findall(
        r"node simulated_cell listens to (\S+): replayed orders would", refused.stderr
    )
    assert {*found} & {"/drive/angle", "/cell/probe_target"}, refused.stderr  # one may come later
    for name in ("simulated_cell", "planner", "recorder", "capture", "solver"):
        live.kill(name)
    live.start("capture", name="capture", arguments=(*DRIVE, *SEEN))
    live.start("solver", arguments=SEEN)
    again = live.folder / "again.json"
    done = rotcal(
        "replay", live.bag, "--rate", 3, "--clock", "--result", again,
        "--wait-for", "capture", "--wait-for", "solver",
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    assert "59 accepted observations, equal to the recorded ones to the last bit" in done.stdout
    assert again.read_text() == recorded
    assert done.returncode == (json.loads(recorded)["verdict"] != "ok")
    assert "left out: /cell/seen: nodes made it of the streams" in done.stderr
