"""The frames of a cell: what headers name, and what /tf_static says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rclpy.node import Node

from rotcal_ros.catalogue.check_lines import CheckLine
from rotcal_ros.geometry.frames import FrameTree, Pose
from rotcal_ros.nodes.frames import StaticFrames
from rotcal_ros.nodes.preflight import frame_doubts

if TYPE_CHECKING:
    from rotcal_ros.nodes.check_heard import Heard


_TODO: Final = "publish the points in the machine frame, or set cell.machine_frame to its name"


class FramesHeard:
    """What is heard of frames from now on."""

    def __init__(self, node: Node) -> None:
        self._static = StaticFrames(node)

    def lines(self, heard: Heard) -> Iterator[CheckLine]:
        """Yield which frames the headers name, and what is static among them."""
        cell, named = heard.configuration.cell, _by_frame(heard)
        if named:
            words = (f"{frame or 'no frame_id'} in {', '.join(t)}" for frame, t in named.items())
            yield CheckLine("frames", "headers", "note", "; ".join(words))
        for doubt in frame_doubts(heard.values, heard.configuration):
            yield CheckLine("frames", "probe_point", "doubt", doubt, _TODO)
        if not self._static.heard:
            found = "not heard: tf2_msgs is not installed here (a ROS installation has it)"
            yield CheckLine("frames", "tf_static", "note", found)
            return
        tree = FrameTree(self._static.frames)
        for frame in (cell.table_frame, cell.tracer_frame):
            pose = tree.pose(frame, cell.machine_frame)
            where = "not joined" if pose is None else _words(pose)
            yield CheckLine("frames", f"tf {frame}", "note", f"in {cell.machine_frame}: {where}")


def _by_frame(heard: Heard) -> dict[str, list[str]]:
    """Return frame -> topics that are stamped with it."""
    named: dict[str, list[str]] = {}
    for topic, watch in sorted(heard.headers.items()):
        for frame in watch.frames:
            named.setdefault(frame, []).append(topic)
    return named


def _words(pose: Pose) -> str:
    origin, z = (", ".join(f"{x:.4f}" for x in v) for v in (pose.origin, pose.axes[:, 2]))
    return f"at ({origin}) m, z along ({z})"
