"""The scene node: plan, table, targets and errors as markers, for RViz, Foxglove and so on.

No other node needs it. It publishes rarely and only what has changed, since all of it goes into
the bag; ``tf`` is published where the package tf2_msgs is installed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rotcal_msgs.msg import CalibrationPlan, DeviationArray, ProbeTarget
from rotcal_msgs.msg import Observation as ObservationMsg
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from rotcal_ros.bags import names
from rotcal_ros.capture import messages
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.node_state import LOADING, NO_PLAN, NodeState, State, Why
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.nodes.runtime.announced_plan import calibration_from_message
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.conversions import make_header
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.nodes.scene import drawing


def marker_array(shapes: Iterable[drawing.Shape], stamp_ns: int) -> MarkerArray:
    """Return a whole scene, which replaces what its topic has shown before."""
    clear = Marker(header=make_header(stamp_ns), action=Marker.DELETEALL)
    return MarkerArray(markers=[clear, *(_marker(shape, stamp_ns) for shape in shapes)])


def transform_message(frame: drawing.Transform, stamp_ns: int) -> TransformStamped:
    """Return the message of a frame."""
    message = TransformStamped(
        header=make_header(stamp_ns, frame.parent), child_frame_id=frame.child
    )
    message.transform.translation = _vector(*frame.translation)
    half = frame.angle / 2.0
    message.transform.rotation = Quaternion(z=math.sin(half), w=math.cos(half))
    return message


def _marker(shape: drawing.Shape, stamp_ns: int) -> Marker:
    marker = Marker(header=make_header(stamp_ns), ns=shape.name, id=0, action=Marker.ADD)
    match shape:
        case drawing.Disc():
            marker.type = Marker.CYLINDER
            marker.pose.position = _point(shape.centre)
            diameter = 2.0 * shape.radius
            marker.scale = _vector(diameter, diameter, shape.thickness)
            marker.color = _colour(shape.colour)
        case drawing.Lines():
            marker.type = Marker.LINE_LIST
            marker.points = _points(shape.points)
            marker.scale.x = shape.width
            marker.color = _colour(shape.colour)
        case drawing.Balls():
            marker.type = Marker.SPHERE_LIST
            marker.points = _points(shape.points)
            marker.scale = _vector(*[shape.diameter] * 3)
            marker.colors = [_colour(colour) for colour in shape.colours]
            marker.color = marker.colors[0]
        case drawing.Label():
            marker.type = Marker.TEXT_VIEW_FACING
            marker.pose.position = _point(shape.place)
            marker.scale.z = shape.height
            marker.color = _colour(shape.colour)
            marker.text = shape.text
    return marker


def _points(points: Floats) -> list[Point]:
    return [_point(row) for row in points.reshape(-1, 3).tolist()]


def _point(place: Any) -> Point:
    x, y, z = place
    return Point(x=x, y=y, z=z)


def _vector(x: float, y: float, z: float) -> Vector3:
    return Vector3(x=x, y=y, z=z)


def _colour(colour: drawing.Colour) -> ColorRGBA:
    red, green, blue, opacity = colour
    return ColorRGBA(r=red, g=green, b=blue, a=opacity)


try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # there is no wheel of it; a ROS installation has it
    TFMessage = None

MOTION_PERIOD_S: Final = 0.5
STILL_PERIOD_S: Final = 2.0
LEAST_TURN: Final = 0.1 * DEGREE
"""A smaller turn of the table (rad) is not shown."""
NEWEST: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""The table's feedback, whatever the drive offers."""


class SceneNode(CellNode):
    """Keeps what it hears, and draws it when a timer finds something new."""

    def __init__(self) -> None:
        super().__init__("scene")

    def configure(self) -> None:
        """Wait for a plan."""
        self._exaggeration = self._wanted_exaggeration()
        self._layout: drawing.SceneLayout | None = None
        self._progress: drawing.SceneProgress | None = None
        self._errors: drawing.DrawnDeviations | None = None
        self._announced = False
        self._joint, self._heard = "", set[str]()
        self._state = NO_PLAN
        self._feedback: JointState | None = None
        self._step: int | None = None
        self._changed = False
        self._shown: tuple[float, int | None] | None = None
        self._scene = self.create_publisher(MarkerArray, "scene", LATCHED)
        self._moving = self.create_publisher(MarkerArray, "scene_motion", LATCHED)
        self._frames = FrameBroadcaster(self)
        self.listen(CalibrationPlan, names.PLAN, self._take_plan, LATCHED, judged=True)
        self.listen(DeviationArray, "deviations", self._take_errors, LATCHED)
        self.listen(ProbeTarget, names.PROBE_TARGET, self._take_order, EVENT)
        self.listen(ObservationMsg, names.OBSERVATION, self._take, EVENT)
        self._hear_feedback(names.JOINT_STATES)
        self.every(MOTION_PERIOD_S, self._show_moving)
        self.every(STILL_PERIOD_S, self._show_still)

    def _take_plan(self, message: CalibrationPlan) -> None:
        self._layout, self._state = None, LOADING
        self.health.beat()
        calibration = calibration_from_message(message)
        self._joint = calibration.configuration.cell.joint
        topics = calibration.configuration.topics.renamed()
        self._hear_feedback(topics.get(names.JOINT_STATES, names.JOINT_STATES))
        self._layout = drawing.make_layout(calibration)
        self._progress = drawing.SceneProgress(self._layout)
        self._errors, self._step, self._shown, self._changed = None, None, None, True
        self._announced = False
        self._state = NodeState.of(State.WORKING, Why.DRAWING, message.method)

    def _take_errors(self, message: DeviationArray) -> None:
        columns = [
            np.array(getattr(message, name)) if len(getattr(message, name)) else 0.0
            for name in ("exc", "eyc", "ezc", "eac", "ebc", "ecc")
        ]
        angles = np.array(message.angles)
        table = np.stack([column + np.zeros(len(angles)) for column in columns], axis=1)
        self._errors = drawing.DrawnDeviations(angles, table[:, :3], table[:, 3:])
        self._changed = True

    def _take_order(self, message: ProbeTarget) -> None:
        self._step = message.step
        if self._progress is not None:
            self._progress.order(message.step)
            self._changed = True

    def _take(self, message: ObservationMsg) -> None:
        if self._progress is not None:
            self._progress.observe(message.step, accepted=message.accepted)
            self._changed = True

    def _hear_feedback(self, topic: str) -> None:
        """Listen to the table's feedback there too."""
        if topic not in self._heard:
            self._heard.add(topic)
            self.listen(JointState, topic, self._take_feedback, NEWEST)

    def _take_feedback(self, message: JointState) -> None:
        self._feedback = message

    def _angle(self) -> float:
        """Return the angle (rad) of the table; 0 before it is heard."""
        if self._feedback is None:
            return 0.0
        sample = messages.table_sample(self._feedback, self._joint)
        return 0.0 if sample is None else sample.angle

    def _wanted_exaggeration(self) -> float:
        """Return the setting that may be changed at any time."""
        words = "factor by which errors are drawn larger"
        return float(self.parameter("exaggeration", 20000.0, words, read_only=False))

    def _show_still(self) -> None:
        before, self._exaggeration = self._exaggeration, self._wanted_exaggeration()
        self._changed |= before != self._exaggeration
        if self._layout is None or self._progress is None or not self._changed:
            return
        self._changed = False
        shapes = drawing.draw_static_shapes(
            self._layout, self._progress.states, self._errors, self._exaggeration
        )
        self._scene.publish(marker_array(shapes, self.now_ns()))
        if self._errors is not None and not self._announced:
            self._announced = True
            self.get_logger().info(f"errors are drawn {self._exaggeration:g} times as large")

    def _show_moving(self) -> None:
        if self._layout is None:
            return
        angle, now_ns = self._angle(), self.now_ns()
        step = None if self._step is None else self._layout.steps[self._step]
        self._frames.publish(drawing.moving_frames(self._layout, angle, step), now_ns)
        if self._shown is not None:
            before, step_before = self._shown
            if abs(angle - before) < LEAST_TURN and self._step == step_before:
                return
        self._shown = angle, self._step
        self._moving.publish(
            marker_array(drawing.draw_moving_shapes(self._layout, angle, step), now_ns)
        )

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return self._state, {"tf": self._frames.published}


class FrameBroadcaster:
    """Frames on /tf and /tf_static, which no bag of the cell holds; none without tf2_msgs."""

    def __init__(self, node: Node) -> None:
        self.published = TFMessage is not None
        if self.published:
            self._tf = node.create_publisher(TFMessage, "/tf", EVENT)
            self._tf_static = node.create_publisher(TFMessage, "/tf_static", LATCHED)
            now_ns = node.get_clock().now().nanoseconds
            self._tf_static.publish(_frames_message(drawing.fixed_frames(), now_ns))

    def publish(self, frames: Iterable[drawing.Transform], stamp_ns: int) -> None:
        """Publish frames that move."""
        if self.published:
            self._tf.publish(_frames_message(frames, stamp_ns))


def _frames_message(frames: Iterable[drawing.Transform], stamp_ns: int) -> Any:
    transforms: list[TransformStamped] = [transform_message(frame, stamp_ns) for frame in frames]
    return TFMessage(transforms=transforms)


def main() -> None:
    """Run the scene node."""
    run_node(SceneNode)


if __name__ == "__main__":
    main()
