"""What is to be calibrated: by a goal, by the announced plan, by what an interrupted one left."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from rotcal_msgs.action import Calibrate
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError, RotcalError
from rotcal_ros.foundation.plugins import nearest
from rotcal_ros.foundation.settings import to_mapping
from rotcal_ros.foundation.untrusted import read_text, why
from rotcal_ros.methods import Calibration, prepare
from rotcal_ros.methods.configuration import (
    GROUPS,
    Configuration,
    dump_configuration,
    parse_configuration,
    settings_classes,
)
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.methods.method import DEFAULT, find_method
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.parameters import read_settings
from rotcal_ros.planning.settings import SafetySettings

SAFETY, HEALTH = "safety", "health"
FROM_THE_START: Final = (SAFETY, HEALTH)
"""The groups that hold for all nodes from their start: no goal changes them."""
ALWAYS: Final = ("cell", "plan", "capture", "solver", "planner", *FROM_THE_START)
"""Groups that are parameters of the planner even if it was not given them."""

RUN: Final = "run"
"""Value in a beat: the run of the plan that a node works for; see :func:`run_name`."""


class PlannerParameters:
    """The parameters of a planner: the groups of its configured method, and its ``safety``.

    Raises ConfigurationError, with the nearest name, for whatever the node was given that is
    misspelt or impossible.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        method = find_method(node.parameter("method", DEFAULT, "method of the calibration"))
        for group, value in node.given.items():
            if isinstance(value, dict) and group not in GROUPS:
                raise ConfigurationError(
                    f"{node.get_name()}: parameters: unknown group {group!r}"
                    f"{nearest(group, GROUPS)}"
                )
        self._groups = {
            group: cls
            for group, cls in settings_classes(method).items()
            if group in ALWAYS or group in node.given
        }
        for group, cls in self._groups.items():
            node.settings(group, cls, read_only=group in FROM_THE_START)
        self.safety: SafetySettings = read_settings(node, SAFETY, SafetySettings)
        self._fixed = {SAFETY: self.safety, HEALTH: node.health.settings}

    def configuration(self, goal: Calibrate.Goal) -> Configuration:
        """Return the configuration of a goal, or that of the parameters if it has none."""
        text, source = goal.configuration, "configuration of the goal"
        if not text:
            method = self._node.get_parameter("method").value
            groups = {
                group: to_mapping(read_settings(self._node, group, cls))
                for group, cls in self._groups.items()
            }
            text, source = dump_configuration(method, groups), "parameters of the planner"
        configuration = parse_configuration(text, source)
        for group, own in self._fixed.items():
            if group in configuration.given and configuration.group(group) != own:
                raise ConfigurationError(
                    f"{source}: its group {group} is not the one that the planner was started "
                    "with: start the nodes with this configuration"
                )
        if goal.method and goal.method != configuration.method.name:
            raise ConfigurationError(
                f"the goal asks for method {goal.method!r}, its configuration describes "
                f"{configuration.method.name!r}"
            )
        return configuration

    def judge(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError where no goal can be measured with changes, name -> value."""
        for group in {name.partition(".")[0] for name in changes} & self._groups.keys():
            read_settings(self._node, group, self._groups[group], changes)


def run_name(message: CalibrationPlan) -> str:
    """Return the name that tells this run of a plan from every other run."""
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


def load_method(node: CellNode) -> None:
    """Load the code of the method that a node was given, before it says that it is there.

    The planner reports what cannot be loaded.
    """
    with suppress(RotcalError):
        find_method(str(node.given.get("method") or DEFAULT))


def read_continuation(node: CellNode) -> Continuation | None:
    """Declare ``continuation_file`` and return what it holds; None when it is not given."""
    path = node.parameter(
        "continuation_file", "", "what an interrupted calibration has left; empty: nothing"
    )
    if not path:
        return None
    try:
        return Continuation.from_json(read_text(Path(path)))
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot read the continuation {path}: {why(error)}") from error
