"""Shapes of a scene into markers, and frames into transforms."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from rotcal_ros.arrays import Floats
from rotcal_ros.nodes.conversions import header
from rotcal_ros.scene.shapes import Balls, Colour, Disc, Label, Lines, Shape, Transform


def markers(shapes: Iterable[Shape], stamp_ns: int) -> MarkerArray:
    """Return a whole scene, which takes the place of what its topic has shown before."""
    clear = Marker(header=header(stamp_ns), action=Marker.DELETEALL)
    return MarkerArray(markers=[clear, *(_marker(shape, stamp_ns) for shape in shapes)])


def transform(frame: Transform, stamp_ns: int) -> TransformStamped:
    """Return the message of a frame."""
    message = TransformStamped(header=header(stamp_ns, frame.parent), child_frame_id=frame.child)
    message.transform.translation = _vector(*frame.translation)
    half = frame.angle / 2.0
    message.transform.rotation = Quaternion(z=math.sin(half), w=math.cos(half))
    return message


def _marker(shape: Shape, stamp_ns: int) -> Marker:
    marker = Marker(header=header(stamp_ns), ns=shape.name, id=0, action=Marker.ADD)
    match shape:
        case Disc():
            marker.type = Marker.CYLINDER
            marker.pose.position = _point(shape.centre)
            diameter = 2.0 * shape.radius
            marker.scale = _vector(diameter, diameter, shape.thickness)
            marker.color = _colour(shape.colour)
        case Lines():
            marker.type = Marker.LINE_LIST
            marker.points = _points(shape.points)
            marker.scale.x = shape.width
            marker.color = _colour(shape.colour)
        case Balls():
            marker.type = Marker.SPHERE_LIST
            marker.points = _points(shape.points)
            marker.scale = _vector(*[shape.diameter] * 3)
            marker.colors = [_colour(colour) for colour in shape.colours]
            marker.color = marker.colors[0]
        case Label():
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


def _colour(colour: Colour) -> ColorRGBA:
    red, green, blue, opacity = colour
    return ColorRGBA(r=red, g=green, b=blue, a=opacity)
