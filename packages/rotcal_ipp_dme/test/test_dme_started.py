"""When the adapter is started, in whose place, and what is refused with it."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal as command
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import nodes_of_groups
from rotcal_ros.nodes.adapters.machine_nodes import AS_CONFIGURED, OWN, machine_nodes

CONFIGURATION = Path(__file__).parents[1] / "config" / "ball_plate_dme.yaml"
REAL = ("method", "cell", "plan")


@pytest.mark.parametrize(
    ("groups", "table", "probe", "nodes"),
    [
        (("dme",), AS_CONFIGURED, AS_CONFIGURED, ["dme_adapter"]),
        (("dme", "simulation"), AS_CONFIGURED, AS_CONFIGURED, ["dme_adapter"]),
        (("table_adapter", "dme"), AS_CONFIGURED, AS_CONFIGURED, ["table_adapter", "dme_adapter"]),
        (("table_adapter", "dme"), "table_adapter", OWN, ["table_adapter"]),
        (("table_adapter", "dme"), "dme_adapter", "dme_adapter", ["dme_adapter"]),
        (("dme",), "linuxcnc_driver", AS_CONFIGURED, ["linuxcnc_driver", "dme_adapter"]),
    ],
)
def test_table_and_probe_are_started_once_each(groups, table, probe, nodes):
    assert machine_nodes({*REAL, *groups}, table, probe) == nodes


def test_a_node_without_its_group_is_refused():
    with pytest.raises(ConfigurationError, match="table:=dme_adapter needs a group 'dme'"):
        machine_nodes({"cell"}, "dme_adapter", OWN)


def test_a_simulated_machine_behind_dme_is_no_node():
    assert nodes_of_groups({"simulation", "dme", "cell"}) == ["dme_adapter"]
    assert nodes_of_groups({"dme", "table_adapter"}) == ["table_adapter", "dme_adapter"]


def test_a_cell_behind_dme_is_refused_before_anything_is_made(tmp_path):
    pytest.importorskip("rclpy")
    out = tmp_path / "out"
    found = CliRunner().invoke(command, ["verify", str(CONFIGURATION), "-o", str(out)])
    assert found.exit_code == 2
    assert "puts the simulated cell behind another process" in " ".join(found.stderr.split())
    assert not out.exists()
