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
        (("dme",), AS_CONFIGURED, AS_CONFIGURED, ["dme_adapter"]),
        (("dme", "simulation"), AS_CONFIGURED, AS_CONFIGURED, ["dme_adapter"]),
        (("simulation",), AS_CONFIGURED, AS_CONFIGURED, ["simulated_cell"]),
        (("table_adapter", "dme"), AS_CONFIGURED, AS_CONFIGURED, ["table_adapter", "dme_adapter"]),
        (("table_adapter", "bridge"), OWN, AS_CONFIGURED, ["bridge"]),
        (("table_adapter", "dme"), "table_adapter", OWN, ["table_adapter"]),
        (("table_adapter", "dme"), "dme_adapter", "dme_adapter", ["dme_adapter"]),
        (("dme",), "linuxcnc_driver", AS_CONFIGURED, ["linuxcnc_driver", "dme_adapter"]),
        ((), "linuxcnc_driver", OWN, ["linuxcnc_driver"]),
    ],
)
def test_table_and_probe_are_started_once_each(groups, table, probe, nodes):
    assert machine_nodes({*REAL, *groups}, table, probe) == nodes


def test_a_node_without_its_group_is_refused():
    with pytest.raises(ConfigurationError, match="table:=dme_adapter needs a group 'dme'"):
        machine_nodes({"cell"}, "dme_adapter", OWN)
