"""What is to be calibrated: the announced plan, and what an interrupted one left over."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.catalogue import Calibration, prepare
from rotcal_ros.catalogue.configuration import parse_configuration
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.errors import DataError, PlanError
from rotcal_ros.messages import stamp_ns


def run_name(message: CalibrationPlan) -> str:
    """Return what tells this run of a plan from every other run."""
    return f"{message.plan_id}@{stamp_ns(message.header.stamp)}"


def calibration_of(message: CalibrationPlan) -> Calibration:
    """Return the calibration that a plan message describes.

    Raises PlanError when the configuration leads to another plan here than at the planner,
    which means that the two run different versions; ConfigurationError when it is wrong.
    """
    configuration = parse_configuration(message.configuration, "the announced plan")
    calibration = prepare(configuration)
    found = (configuration.plan_id, len(calibration.plan.steps))
    if found != (message.plan_id, message.total_steps):
        raise PlanError(
            f"the announced plan has {message.total_steps} steps and the hash {message.plan_id}, "
            f"here it has {found[1]} and {found[0]}: install the same version everywhere"
        )
    return calibration


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
