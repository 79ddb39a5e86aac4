"""Plans of a table that turns past its angles: whether they can be carried out."""

from __future__ import annotations

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.planning.plan import Plan


def require_turns(configuration: Configuration, planned: Plan) -> None:
    """Raise PlanError for turns that the cell cannot make, or that take longer than is waited."""
    if "table_adapter" in configuration.given:
        raise PlanError(
            "plan.turning_deg_s: table_adapter moves the table from rest to rest, and makes no "
            "turns: leave one of both out"
        )
    if configuration.planner.policy != AS_LISTED:
        raise PlanError(
            f"plan.turning_deg_s: a turn passes all angles, the policy "
            f"{configuration.planner.policy} chooses single lengths: leave planner.policy out"
        )
    limit_s, before = configuration.planner.step_timeout_s, planned.steps[0]
    for step in planned.steps:
        if step.turn is None:
            continue
        begin = before.table_angle if step.follows(before) else step.turn.begin
        before, way = step, abs(step.table_angle - begin) + step.passing
        if (takes_s := way / abs(step.turn.speed)) > limit_s:
            raise PlanError(
                f"plan.turning_deg_s: the table takes {takes_s:.3g} s to {step.describe()}, "
                f"longer than planner.step_timeout_s = {limit_s:g}: turn faster, or raise that"
            )
