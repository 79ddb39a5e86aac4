"""The command lines of the nodes of a session."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.sessions.running import client_command, node_command, node_names
from rotcal_ros.sessions.session import prepare_session

DEMO = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"


@pytest.fixture
def session(tmp_path):
    return prepare_session(DEMO, tmp_path / "2024", ["cell.namespace=/north"])


def parameters(command):
    """Return the parameters of a command line as ROS reads them."""
    texts = [text.split(":=") for text in command if ":=" in text and "__ns" not in text]
    return {name: yaml.safe_load(value) for name, value in texts}


def test_a_simulated_cell_has_one_node_more(session, tmp_path):
    assert node_names(session)[-1] == "simulated_cell"
    document = yaml.safe_load(DEMO.read_text())
    document["/**"]["ros__parameters"].pop("simulation")
    real = tmp_path / "real.yaml"
    real.write_text(yaml.safe_dump(document))
    assert node_names(prepare_session(real, tmp_path / "x", [])) == [
        "planner", "capture", "solver", "recorder"
    ]  # fmt: skip


def test_the_page_comes_last_where_it_is_wanted(session):
    assert "operator_page" not in node_names(session)
    shown = replace(session, shown_by=("page",))
    assert node_names(shown) == [*node_names(session), "operator_page"]


def test_the_nodes_of_the_first_run(session):
    for name in node_names(session):
        command = node_command(session, name)
        assert command[command.index("--params-file") + 1] == str(session.folder.parameters)
        assert "__ns:=/north" in command
    found = parameters(node_command(session, "recorder"))
    assert found == {
        "recorder.folder": str(session.folder.path.parent),
        "recorder.session": "2024",
    }
    # nobody starts a node of a session again
    assert parameters(node_command(session, "planner")) == {"restart_wait_s": 0.0}
    path = str(session.folder.configuration)
    assert parameters(client_command(session)) == {"configuration_file": path}


def test_the_nodes_of_a_later_run_know_what_is_left(session):
    later = replace(session, continuation=Continuation("id", 2, 7, (1,), (1, 7, 8), ()))
    file = str(later.folder.continuation(2))
    assert parameters(node_command(later, "recorder"))["recorder.run"] == 2
    planner = parameters(node_command(later, "planner"))
    assert planner == {"continuation_file": file, "restart_wait_s": 0.0}
    assert parameters(node_command(later, "solver")) == {"continuation_file": file}
    assert parameters(node_command(later, "capture")) == {}
    assert parameters(client_command(later))["start_index"] == 7
    assert later.log_folder == later.folder.log(2)


def test_a_node_that_no_package_brings_is_named(session):
    with pytest.raises(ConfigurationError, match=r"no node 'hologram'$"):
        node_command(session, "hologram")
