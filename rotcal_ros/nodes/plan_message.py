"""Taking the announced plan: capture and solver derive everything from this one message."""

from __future__ import annotations

from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.catalogue import Calibration, prepare
from rotcal_ros.catalogue.configuration import parse_configuration
from rotcal_ros.errors import PlanError
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
