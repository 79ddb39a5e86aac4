"""Which nodes are the machine: by the groups of a configuration, or by what a launch asks for."""

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.nodes.adapters.machine_nodes import AS_CONFIGURED, OWN, machine_nodes

REAL = ("method", "cell", "plan")


@pytest.mark.parametrize(
    ("groups", "table", "probe", "nodes"),
    [
        ((), AS_CONFIGURED, AS_CONFIGURED, []),
        (("bridge", "table_adapter"), AS_CONFIGURED, AS_CONFIGURED, ["bridge", "table_adapter"]),
        (("simulation",), AS_CONFIGURED, AS_CONFIGURED, ["simulated_cell"]),
        (("table_adapter", "bridge"), OWN, AS_CONFIGURED, ["bridge"]),
        ((), "linuxcnc_driver", OWN, ["linuxcnc_driver"]),
    ],
)
def test_table_and_probe_are_started_once_each(groups, table, probe, nodes):
    assert machine_nodes({*REAL, *groups}, table, probe) == nodes


def test_a_node_without_its_group_is_refused():
    words = "table:=table_adapter needs a group 'table_adapter'"
    with pytest.raises(ConfigurationError, match=words):
        machine_nodes({"cell"}, "table_adapter", OWN)
