"""What a configuration states, as a parameter file that ROS reads."""

from pathlib import Path

import pytest
import yaml

from rotcal_ros.methods import changed, parse_configuration, read_configuration
from rotcal_ros.methods.configuration import node_parameters

CONFIG = Path(__file__).parents[2] / "config"
PAPER = CONFIG / "tracer_paper.yaml"
CONFIGS = sorted(path for path in CONFIG.glob("*.yaml") if not path.stem.endswith("_goal"))


def groups(configuration):
    """Return the groups of a parameter file as YAML reads them."""
    return yaml.safe_load(node_parameters(configuration))["/**"]["ros__parameters"]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_parameters_say_the_same_as_the_configuration(path):
    given = read_configuration(path)
    again = parse_configuration(node_parameters(given))
    for group in ("cell", "plan", "capture", "solver", "planner", "recorder", "simulation"):
        assert again.group(group) == given.group(group)
    assert again.simulated == given.simulated


def test_lists_are_of_one_type_and_nothing_is_empty():
    changes = [
        "plan.box_centre_m=[0, 0, 0.595]",
        "plan.min_elevation_deg=null",
        "plan.table_step_deg=30",
        "bridge={}",
        "topics=null",
    ]
    parameters = groups(changed(read_configuration(PAPER), changes))
    assert list(map(type, parameters["plan"]["box_centre_m"])) == [float] * 3
    assert type(parameters["plan"]["table_step_deg"]) is float
    assert "min_elevation_deg" not in parameters["plan"]
    assert not {"bridge", "topics", "recorder"} & parameters.keys()
