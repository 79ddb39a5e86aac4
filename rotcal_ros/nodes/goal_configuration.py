"""The configuration of a goal: its own text, or what the planner's parameters make."""

from __future__ import annotations

from typing import Final

from rotcal_msgs.action import Calibrate

from rotcal_ros.catalogue.configuration import (
    GROUPS,
    Configuration,
    dump_configuration,
    parse_configuration,
    settings_classes,
)
from rotcal_ros.catalogue.method import DEFAULT, find_method
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.parameters import read_settings
from rotcal_ros.plugins import nearest
from rotcal_ros.settings import to_mapping

ALWAYS: Final = ("cell", "plan", "capture", "solver", "planner")
"""Groups that are parameters of the planner even if it was not given them."""


class PlannerParameters:
    """The parameters of a planner: the groups of its configured method.

    Raises ConfigurationError, with the nearest name, for whatever the node was given that is
    misspelt or impossible.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        method = find_method(node.declare_parameter("method", DEFAULT).value)
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
            node.settings(group, cls, read_only=False)

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
        if goal.method and goal.method != configuration.method.name:
            raise ConfigurationError(
                f"the goal asks for method {goal.method!r}, its configuration describes "
                f"{configuration.method.name!r}"
            )
        return configuration
