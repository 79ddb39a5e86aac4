"""Taking up an interrupted plan: planner and solver read one continuation file."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.errors import DataError


def read_continuation(node: Node) -> Continuation | None:
    """Declare ``continuation_file`` and return what it holds; None when it is not given."""
    path = node.declare_parameter("continuation_file", "").value
    if not path:
        return None
    try:
        return Continuation.from_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot read the continuation {path}: {error}") from error


def what_is_left(
    known: Continuation | None, calibration: Calibration, start_index: int
) -> Continuation:
    """Return the ``known`` continuation if a goal asks for it, else all steps from an index on.

    Raises PlanError when the plan has no such step.
    """
    plan_id, plan = calibration.configuration.plan_id, calibration.plan
    if known is not None and (known.plan_id, known.start_index) == (plan_id, start_index):
        return known
    plan.step(start_index)
    return Continuation(
        plan_id, 0, start_index, (), tuple(range(start_index, len(plan.steps))), ()
    )
