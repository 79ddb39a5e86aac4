"""The scene as it came over DDS into the bag of a calibration; the layout for Foxglove."""

import json
import math
import os
import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, wait_until
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from rotcal_ros.nodes.scene.drawing import COLOURS, TargetState

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytest.importorskip("visualization_msgs")
pytestmark = pytest.mark.ros

LAYOUT = Path(__file__).parents[3] / "config" / "foxglove" / "rotcal.json"
SHARE = 0.1
"""Of the bytes of a bag that the scene may take."""


def read(bag, topic):
    """Return the messages of a topic in a bag."""
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [message for *_, message in reader.iter_decoded_messages([topic])]


def sizes_by_topic(bag):
    """Return the bytes of the messages of each topic."""
    (file,) = bag.glob("*.mcap")
    sizes = Counter()
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            sizes[channel.topic] += len(message.data)
    return sizes


def named(array):
    return {marker.ns: marker for marker in array.markers if marker.action == 0}


@pytest.mark.long
def test_a_calibration_is_drawn_and_does_not_end_with_its_scene(cell, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    live = cell("simulation.time_scale=10.0")
    live.start(*SUITE, "simulated_cell", "scene")
    client = live.client()
    client.wait_for_step(50)
    with live.held():
        live.wait_for_log("scene", "errors are drawn 20000 times as large")
    client.wait_for_step(52)
    live.kill("scene")
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]

    scenes = [named(array) for array in read(live.bag, "/cell/scene")]
    assert len(scenes) >= 2
    first, last = scenes[0]["places"], scenes[-1]["places"]
    assert first.header.frame_id == "table_base"
    assert len(first.points) == len(first.colors) == 3 * 2 * 2  # plan.box_points
    done = pytest.approx(COLOURS[TargetState.DONE], abs=1e-6)
    assert sum((c.r, c.g, c.b, c.a) == done for c in last.colors) >= 3
    errors = next(scene for scene in scenes if "errors" in scene)
    assert errors["exaggeration"].text == "errors x 20000"

    tables = [named(array) for array in read(live.bag, "/cell/scene_motion")]
    marks = [scene["zero mark"].points for scene in tables]
    drawn = np.array([math.atan2(end.y, end.x) for _, end in marks])
    told = np.array([message.position[0] for message in read(live.bag, "/cell/joint_states")])
    assert len(np.unique(drawn.round(3))) >= 3
    apart = np.abs(np.angle(np.exp(1j * (drawn[:, None] - told))))
    assert (apart.min(axis=1) < 1e-9).all()
    beams = [scene["beam"].points for scene in tables if "beam" in scene]
    places = {(p.x, p.y, p.z) for p in first.points}
    assert beams
    assert all((end.x, end.y, end.z) in places for _, end in beams)


@pytest.mark.long
def test_every_topic_of_the_foxglove_layout_is_published(rotcal, tmp_path):
    folder = tmp_path / "out"
    run = rotcal("--output", folder, "--scene", "--no-report", "--no-export", log=tmp_path / "log")
    wait_until(lambda: run.poll() is not None, "the calibration ends")
    assert run.returncode == 0, (tmp_path / "log").read_text()
    sizes = sizes_by_topic(folder / "bag")
    named_topics = set(re.findall(r'"(/[a-z_/]+)', LAYOUT.read_text()))
    assert {"/cell/scene", "/cell/deviations", "/diagnostics", "/rosout"} <= named_topics
    quiet = {"/rosout"}  # every ROS node offers it, and says nothing when all is well
    assert named_topics - quiet - sizes.keys() == set()
    panels = json.loads(LAYOUT.read_text())
    assert set(re.findall(r'"(\w+!\w+)"', json.dumps(panels["layout"]))) == set(
        panels["configById"]
    )
    drawn = sizes["/cell/scene"] + sizes["/cell/scene_motion"]
    assert drawn < SHARE * sum(sizes.values()), (drawn, sum(sizes.values()))
