"""What static transforms say of the cell, held against what the lengths say: where they differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.results import Placement, Result
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.frames import FrameTree, StaticFrame
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.settings import CellSettings


def frame_conflicts(
    cell: CellSettings, plan: Plan, result: Result, frames: Iterable[StaticFrame]
) -> tuple[Phrase, ...]:
    """Return in words where static ``frames`` contradict a result by more than is allowed.

    Empty where they agree, where none joins the frames of the cell, or the method finds no axis.
    """
    tree, placed = FrameTree(frames), result.placement
    if placed is None:
        return ()
    return (*_of_the_table(cell, tree, placed), *_of_the_tracer(cell, plan, tree, placed))


def _of_the_table(cell: CellSettings, tree: FrameTree, axis: Placement) -> Iterator[Phrase]:
    """Yield where the table's frame is not on the axis, or its z not along it."""
    pose = tree.pose(cell.table_frame, cell.machine_frame)
    if pose is None:
        return
    names = phrase("tf has {0} in {1}", printable(cell.table_frame), printable(cell.machine_frame))
    off = axis.distance(pose.origin)
    if off > cell.frame_tolerance_m:
        yield phrase(
            "{0} at {1}, {2:.1f} mm from the axis of the solution, which goes through {3}; "
            "allowed {4:g} mm", names, _place(pose.origin),
            off / MILLIMETRE, _place(axis.point), cell.frame_tolerance_m / MILLIMETRE
        )  # fmt: skip
    z = pose.axes[:, 2]
    tilt = float(np.arctan2(np.linalg.norm(np.cross(z, axis.direction)), z @ axis.direction))
    if tilt > cell.frame_tolerance_deg * DEGREE:
        yield phrase(
            "{0} with z along {1}, {2:.2f} degrees from the axis of the solution, {3}; allowed "
            "{4:g}",
            names, _direction(z), tilt / DEGREE, _direction(axis.direction),
            cell.frame_tolerance_deg,
        )  # fmt: skip


def _of_the_tracer(
    cell: CellSettings, plan: Plan, tree: FrameTree, placed: Placement
) -> Iterator[Phrase]:
    """Yield where the tracer's frame, carried by the table, is not at the solved stations."""
    pose = tree.pose(cell.tracer_frame, cell.machine_frame)
    if pose is None or not len(placed.positions):
        return
    angles = [plan.table_angles[number] for number in placed.positions.tolist()]
    turns = [rotation_from_vector(angle * placed.direction) for angle in angles]
    by_tf = np.array(turns) @ (pose.origin - placed.point) + placed.point
    off = np.linalg.norm(placed.stations - by_tf, axis=1)
    worst = int(np.argmax(off))
    if off[worst] > cell.frame_tolerance_m:
        yield phrase(
            "tf has {0} in {1} at {2}; with the table at {3:g} degrees that is {4:.1f} mm "
            "from the station of the solution, {5}; allowed {6:g} mm",
            printable(cell.tracer_frame), printable(cell.machine_frame), _place(pose.origin),
            angles[worst] / DEGREE, off[worst] / MILLIMETRE, _place(placed.stations[worst]),
            cell.frame_tolerance_m / MILLIMETRE,
        )  # fmt: skip


def _place(point: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in point)}) m"


def _direction(vector: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in vector)})"
