"""Chooses the nodes that play the table and the probe of a cell."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import group_nodes, nodes_of_groups

AS_CONFIGURED: Final = "as_configured"
OWN: Final = "own"
"""A node of the user's own, which is not started here."""
_OURS: Final[dict[str, dict[str, str]]] = {
    "table": {"table_adapter": "table_adapter", "linuxcnc_driver": ""},
    "probe": {},
}


def nodes_for_role(role: str) -> dict[str, str]:
    """Return the nodes that can be asked for, and the group of the configuration that each needs.

    ``role``: table or probe.
    """
    others = {node.name: group for group, node in group_nodes().items() if role in node.roles}
    return _OURS[role] | others


def machine_nodes(groups: Collection[str], table: str, probe: str) -> list[str]:
    """Return the nodes of a cell besides those of every cell, each once.

    ``groups`` are those of the configuration, ``table`` and ``probe`` are AS_CONFIGURED, OWN or
    a node that is able to it. ConfigurationError when that node lacks its group.
    """
    asked = (("table", table, nodes_for_role("table")), ("probe", probe, nodes_for_role("probe")))
    for role, node, known in asked:
        if (group := known.get(node)) and group not in groups:
            raise ConfigurationError(
                f"{role}:={node} needs a group '{group}' in the configuration, which has "
                f"{', '.join(sorted(groups)) or 'no group'}; see rotcal settings {group}"
            )
    further = nodes_of_groups(groups)
    wanted = [node for node in further if node not in {**asked[0][2], **asked[1][2]}]
    for _, node, known in asked:
        wanted += [n for n in further if n in known][:1] if node == AS_CONFIGURED else [node]
    return [node for node in dict.fromkeys(wanted) if node != OWN]
