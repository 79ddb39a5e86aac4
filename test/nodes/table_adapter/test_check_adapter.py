"""What a check says of the controller behind an adapter, by the graph alone; no nodes."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.table_adapter import joint_controllers
from rotcal_ros.nodes.table_adapter.check import AdapterTablePreview
from rotcal_ros.planning.settings import TableAdapterSettings

STATUS = "/drive/follow_joint_trajectory/_action/status"


def line_of(monkeypatch, interface, *, installed, publishers=(), listeners=()):
    """Return the line of a controller with these topics; ``installed``: control_msgs is."""
    ends = [SimpleNamespace(node_name="drive", topic_type="")]
    node = SimpleNamespace(
        resolve_topic_name=lambda name: name,
        get_publishers_info_by_topic=lambda topic: ends if topic in publishers else [],
        get_subscriptions_info_by_topic=lambda topic: ends if topic in listeners else [],
    )
    monkeypatch.setattr(joint_controllers, "find_spec", lambda _: installed or None)
    settings = TableAdapterSettings(controller="/drive", interface=interface)
    ears = AdapterTablePreview.__new__(AdapterTablePreview)
    ears._settings, ears._node = settings, node
    (line,) = ears.controller_lines()
    return line


@pytest.mark.parametrize("interface", ["auto", "goals"])
def test_goals_are_looked_for_at_the_action(monkeypatch, interface):
    line = line_of(monkeypatch, interface, installed=True, publishers=[STATUS])
    assert (line.state, line.found) == (
        "good", "node drive takes goals on /drive/follow_joint_trajectory"
    )  # fmt: skip
    missing = line_of(monkeypatch, interface, installed=True, listeners=["/drive/commands"])
    assert missing.state == "missing"
    assert missing.todo == "set table_adapter.interface: positions"


def test_auto_without_the_messages_of_goals_is_the_topic(monkeypatch):
    topic = "/drive/joint_trajectory"
    assert line_of(monkeypatch, "auto", installed=False, listeners=[topic]).state == "good"
    line = line_of(monkeypatch, "auto", installed=False, publishers=[STATUS])
    assert line.state == "missing"
    assert "no node takes trajectory on /drive/joint_trajectory" in line.found


def test_goals_without_their_messages_and_nobody_at_all_are_missing(monkeypatch):
    line = line_of(monkeypatch, "goals", installed=False, publishers=[STATUS])
    assert "need the package control_msgs" in line.found
    line = line_of(monkeypatch, "positions", installed=True)
    assert line.todo == "start and activate the controller, or correct table_adapter.controller"
