"""Chooses the nodes that play the table and the probe of a cell."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.node_names import further_nodes

AS_CONFIGURED: Final = "as_configured"
OWN: Final = "own"
"""A node of the user's own, which is not started here."""
TABLES: Final[Mapping[str, str]] = {
    "table_adapter": "table_adapter",
    "dme_adapter": "dme",
    "linuxcnc_driver": "",
}
PROBES: Final[Mapping[str, str]] = {"dme_adapter": "dme"}
"""Nodes that can be asked for: node -> group of the configuration that it needs."""


def machine_nodes(groups: Collection[str], table: str, probe: str) -> list[str]:
    """Return the nodes of a cell besides those of every cell, each once.

    ``groups`` are those of the configuration, ``table`` and ``probe`` are AS_CONFIGURED, OWN or
    a node of TABLES and PROBES. ConfigurationError when that node lacks its group.
    """
    asked = (("table", table, TABLES), ("probe", probe, PROBES))
    for role, node, able in asked:
        if (group := able.get(node)) and group not in groups:
            raise ConfigurationError(
                f"{role}:={node} needs a group '{group}' in the configuration, which has "
                f"{', '.join(sorted(groups)) or 'no group'}; see rotcal settings {group}"
            )
    further = further_nodes(groups)
    wanted = [node for node in further if node not in {*TABLES, *PROBES}]
    for _, node, able in asked:
        wanted += [n for n in further if n in able][:1] if node == AS_CONFIGURED else [node]
    return [node for node in dict.fromkeys(wanted) if node != OWN]
