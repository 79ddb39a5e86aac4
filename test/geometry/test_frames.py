"""Trees of static transforms against compositions by hand."""

from math import nan, sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotcal_ros.geometry.frames import FrameTree, StaticFrame

NO_TURN = (0.0, 0.0, 0.0, 1.0)
QUARTER_Z = (0.0, 0.0, sqrt(0.5), sqrt(0.5))


def test_a_chain_is_composed_from_the_root():
    # base is turned by a quarter about z in machine: its x is the machine's y
    tree = FrameTree([
        StaticFrame("machine", "base", (1.0, 2.0, 3.0), QUARTER_Z),
        StaticFrame("base", "tracer", (0.3, 0.0, 0.1), NO_TURN),
    ])  # fmt: skip
    pose = tree.pose("tracer", "machine")
    assert pose.origin == pytest.approx([1.0, 2.3, 3.1])
    assert pose.axes[:, 0] == pytest.approx([0.0, 1.0, 0.0])
    back = tree.pose("machine", "tracer")
    assert back.origin == pytest.approx([-2.3, 1.0, -3.1])
    assert (back @ pose).axes == pytest.approx(np.eye(3))


def test_frames_with_a_common_ancestor_are_joined_and_others_are_not():
    tree = FrameTree([
        StaticFrame("world", "machine", (1.0, 0.0, 0.0), NO_TURN),
        StaticFrame("/world", "/table", (1.0, 1.0, 0.0), NO_TURN),
        StaticFrame("elsewhere", "lamp", (0.0, 0.0, 0.0), NO_TURN),
    ])  # fmt: skip
    assert tree.pose("table", "machine").origin == pytest.approx([0.0, 1.0, 0.0])
    assert tree.pose("lamp", "machine") is None
    assert tree.pose("nobody", "machine") is None
    assert "lamp" in tree
    assert "nobody" not in tree


def test_quaternions_turn_as_scipy_says_whatever_their_norm():
    quaternion = (0.1, -0.4, 0.3, 0.8)
    tree = FrameTree([StaticFrame("a", "b", (0.0, 0.0, 0.0), quaternion)])
    assert tree.pose("b", "a").axes == pytest.approx(Rotation.from_quat(quaternion).as_matrix())


def test_what_cannot_be_used_is_left_out_and_a_loop_ends():
    bad = [
        StaticFrame("machine", "b", (nan, 0.0, 0.0), NO_TURN),
        StaticFrame("machine", "c", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        StaticFrame("x", "y", (0.0, 0.0, 0.0), NO_TURN),
        StaticFrame("y", "x", (1.0, 0.0, 0.0), NO_TURN),
    ]
    tree = FrameTree(bad)
    assert tree.pose("b", "machine") is tree.pose("c", "machine") is None
    assert tree.pose("x", "machine") is None
    assert tree.pose("x", "x").origin == pytest.approx([0.0, 0.0, 0.0])


def test_of_a_child_that_is_told_twice_the_last_one_counts():
    twice = [StaticFrame("a", "b", (x, 0.0, 0.0), NO_TURN) for x in (1.0, 2.0)]
    assert FrameTree(twice).pose("b", "a").origin == pytest.approx([2.0, 0.0, 0.0])
