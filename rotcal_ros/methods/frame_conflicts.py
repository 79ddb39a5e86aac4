"""What static transforms say of the cell, held against what the lengths say: where they differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.frames import FrameTree, StaticFrame
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.settings import CellSettings


@dataclass(frozen=True)
class Axis:
    """The axis of the table in the machine frame: a ``point`` (3,) m on it, its ``direction``."""

    point: Floats
    direction: Floats

    def distance(self, place: Floats) -> float:
        """Return how far (m) a ``place`` is from it."""
        return float(np.linalg.norm(np.cross(place - self.point, self.direction)))

    def carried(self, place: Floats, angle: float) -> Floats:
        """Return where ``place`` gets when the table turns by ``angle`` (rad)."""
        turn: Floats = rotation_from_vector(angle * self.direction)
        return np.asarray(turn @ (place - self.point) + self.point)


def solved_axis(details: Mapping[str, Any]) -> Axis | None:
    """Return the axis that a result tells of; None for a method that finds none."""
    try:
        if "axis" in details:
            point, direction = details["axis"]["origin"], details["axis"]["direction"]
        else:
            point, direction = details["circle"]["centre"], details["plane"]["normal"]
    except (IndexError, KeyError, TypeError):
        return None
    unit = np.asarray(direction, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    return Axis(np.asarray(point, dtype=np.float64), unit if unit[2] >= 0 else -unit)


def frame_conflicts(
    cell: CellSettings, plan: Plan, result: Result, frames: Iterable[StaticFrame]
) -> tuple[str, ...]:
    """Return in words where static ``frames`` contradict a result by more than is allowed.

    Empty where they agree, where none joins the frames of the cell, or the method finds no axis.
    """
    tree, axis = FrameTree(frames), solved_axis(result.details)
    if axis is None:
        return ()
    return (*_of_the_table(cell, tree, axis), *_of_the_tracer(cell, plan, result, tree, axis))


def _of_the_table(cell: CellSettings, tree: FrameTree, axis: Axis) -> Iterator[str]:
    """Yield where the table's frame is not on the axis, or its z not along it."""
    pose = tree.pose(cell.table_frame, cell.machine_frame)
    if pose is None:
        return
    names = f"tf has {printable(cell.table_frame)} in {printable(cell.machine_frame)}"
    off = axis.distance(pose.origin)
    if off > cell.frame_tolerance_m:
        yield (
            f"{names} at {_place(pose.origin)}, {off / MILLIMETRE:.1f} mm from the axis of the "
            f"solution, which goes through {_place(axis.point)}; allowed "
            f"{cell.frame_tolerance_m / MILLIMETRE:g} mm (cell.frame_tolerance_m)"
        )
    z = pose.axes[:, 2]
    tilt = float(np.arctan2(np.linalg.norm(np.cross(z, axis.direction)), z @ axis.direction))
    if tilt > cell.frame_tolerance_deg * DEGREE:
        yield (
            f"{names} with z along {_direction(z)}, {tilt / DEGREE:.2f} degrees from the axis of "
            f"the solution, {_direction(axis.direction)}; allowed {cell.frame_tolerance_deg:g} "
            "(cell.frame_tolerance_deg)"
        )


def _of_the_tracer(
    cell: CellSettings, plan: Plan, result: Result, tree: FrameTree, axis: Axis
) -> Iterator[str]:
    """Yield where the tracer's frame, carried by the table, is not at the solved stations."""
    pose = tree.pose(cell.tracer_frame, cell.machine_frame)
    stations, ids = result.details.get("stations"), result.details.get("station_ids")
    if pose is None or stations is None or ids is None:
        return
    solved = np.asarray(stations, dtype=np.float64)
    angles = [plan.table_angles[number] for number in np.asarray(ids).tolist()]
    by_tf = np.array([axis.carried(pose.origin, angle) for angle in angles])
    off = np.linalg.norm(solved - by_tf, axis=1)
    worst = int(np.argmax(off))
    if off[worst] > cell.frame_tolerance_m:
        yield (
            f"tf has {printable(cell.tracer_frame)} in {printable(cell.machine_frame)} at "
            f"{_place(pose.origin)}; with the table at {angles[worst] / DEGREE:g} degrees that is "
            f"{off[worst] / MILLIMETRE:.1f} mm from the station of the solution, "
            f"{_place(solved[worst])}; allowed {cell.frame_tolerance_m / MILLIMETRE:g} mm "
            "(cell.frame_tolerance_m)"
        )


def _place(point: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in point)}) m"


def _direction(vector: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in vector)})"
