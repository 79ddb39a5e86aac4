"""One list of nodes for everybody: packaging, launch, sessions, preflight, documentation."""

import ast
import runpy
import subprocess
import sys
from importlib import import_module
from inspect import isabstract, isclass
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import yaml

from rotcal_ros.foundation.node_names import (
    DRIVERS,
    EXECUTABLES,
    FURTHER_NODES,
    NODES,
    PREFLIGHT_NODES,
    VIEWERS,
)
from rotcal_ros.foundation.plugins import node_module, nodes_of_groups
from rotcal_ros.methods.configuration import GROUPS
from rotcal_ros.sessions import running

ROOT = Path(__file__).parents[2]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "rotcal_ros").glob("nodes/**/*.py")
    if 'if __name__ == "__main__"' in path.read_text()
}
NO_NODES = {
    "adapters.linuxcnc_agent",
    "check.cell_check",
    "check.message_trial",
    "check.rate_trial",
    "check.start_trial",
    "check.trial_motion",
    "client.json_client",
    "player.node",
    "readiness",
}
"""Programs beside the nodes that others start."""


def test_every_node_is_a_module_with_a_main_and_every_such_module_is_listed():
    modules = {node_module(name) for name in EXECUTABLES}
    others = {f"rotcal_ros.nodes.{name}" for name in NO_NODES}
    assert modules == MODULES - others
    for module in modules:
        tree = ast.parse((ROOT / module.replace(".", "/")).with_suffix(".py").read_text())
        assert "main" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("name", EXECUTABLES)
def test_every_node_reports_its_state(name):
    pytest.importorskip("rclpy")
    pytest.importorskip("rotcal_msgs")
    module = import_module(node_module(name))
    base = import_module("rotcal_ros.nodes.runtime.cell_node").CellNode
    classes = [c for c in vars(module).values() if isclass(c) and issubclass(c, base)]
    (node,) = (c for c in classes if c is not base)
    assert not isabstract(node)


def test_the_lists_fit_each_other():
    assert len(set(EXECUTABLES)) == len(EXECUTABLES)
    elsewhere = {*FURTHER_NODES.values(), *VIEWERS.values(), *DRIVERS}
    assert set(EXECUTABLES) == {*NODES, *elsewhere}
    assert set(PREFLIGHT_NODES) == set(NODES) - {"planner"}
    assert set(FURTHER_NODES) <= set(GROUPS)
    assert not set(VIEWERS.values()) & set(PREFLIGHT_NODES)


def test_the_package_installs_a_command_for_every_node(monkeypatch):
    monkeypatch.chdir(ROOT)
    setup = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: setup.update(arguments))
    runpy.run_path("setup.py")
    commands = dict(c.split(" = ") for c in setup["entry_points"]["console_scripts"])
    commands.pop("rotcal")
    assert commands == {name: f"{node_module(name)}:main" for name in EXECUTABLES}


def test_sessions_and_preflight_use_the_same_lists():
    assert running.NODES is NODES
    assert running.nodes_of_groups is nodes_of_groups
    assert running.VIEWERS is VIEWERS


def test_each_group_starts_its_node():
    assert nodes_of_groups({"simulation", "bridge"}) == ["bridge", "simulated_cell"]
    assert nodes_of_groups({"instrument", "cell"}) == ["instrument_driver"]


def test_the_names_are_known_without_numpy():
    code = "import sys, rotcal_ros.foundation.node_names; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


@pytest.mark.parametrize("bridge", [True, False])
@pytest.mark.parametrize("simulated", [True, False])
def test_the_launch_file_starts_what_is_listed(monkeypatch, tmp_path, bridge, simulated):
    text = (ROOT / "config" / "tracer_paper.yaml").read_text()
    file = tmp_path / "cell.yaml"
    file.write_text(text + ("    bridge: {controller: csv}\n" if bridge else ""))
    started = launched(monkeypatch, file, simulated=simulated)
    further = [FURTHER_NODES["bridge"]] * bridge + [FURTHER_NODES["simulation"]] * simulated
    assert [node["executable"] for node in started] == [*NODES, *further]


@pytest.mark.parametrize("argument", VIEWERS)
def test_the_launch_file_starts_nodes_for_people_when_asked_to(monkeypatch, argument):
    file = ROOT / "config" / "tracer_paper.yaml"
    started = launched(monkeypatch, file, simulated=False, **{argument: "true"})
    assert [node["executable"] for node in started] == [*NODES, VIEWERS[argument]]


def test_a_real_configuration_starts_no_simulation(monkeypatch):
    with pytest.raises(RuntimeError, match="is for a real cell"):
        launched(monkeypatch, ROOT / "config" / "tracer.yaml", simulated=True)


@pytest.mark.parametrize(("given", "place"), [("", "/lab"), ("/other", "/other")])
def test_the_configuration_says_where_the_cell_is_and_somebody_whether_nodes_come_back(
    monkeypatch, tmp_path, given, place
):
    file = tmp_path / "cell.yaml"
    text = (ROOT / "config" / "tracer_paper.yaml").read_text()
    file.write_text(text.replace("namespace: /cell", "namespace: /lab"))
    for respawn in ("true", "false"):
        more = {"namespace": given, "respawn": respawn} if given else {"respawn": respawn}
        started = launched(monkeypatch, file, simulated=False, place=place, **more)
        assert {node["namespace"] for node in started} == {place}
        assert {node["respawn"] for node in started} == {respawn == "true"}


def test_the_nodes_get_lists_of_one_type_whatever_the_file_has(monkeypatch, tmp_path):
    file = tmp_path / "cell.yaml"
    text = (ROOT / "config" / "tracer_paper.yaml").read_text()
    file.write_text(text.replace("box_size_m: [0.45, 0.6, 0.45]", "box_size_m: [1, 0.6, 0.45]"))
    first, *_ = launched(monkeypatch, file, simulated=False)
    given_file, own = first["parameters"]
    assert own == {"autostart": True}
    given = yaml.safe_load(Path(given_file).read_text())["/**"]["ros__parameters"]
    sizes = given["plan"]["box_size_m"]
    assert sizes == [1.0, 0.6, 0.45]
    assert {type(size) for size in sizes} == {float}


def launched(monkeypatch, file, *, simulated, place="/cell", **more):
    """Return the nodes that the launch file starts, each with its options."""
    values = {"configuration": str(file), "simulated": str(simulated).lower()} | more
    started, later, watched = [], [], []
    stub = MagicMock()
    stub.DeclareLaunchArgument.side_effect = lambda name, default_value, **_: values.setdefault(
        name, default_value
    )
    stub.LifecycleNode.side_effect = lambda **options: started.append(options)
    stub.ExecuteProcess.side_effect = lambda **options: watched.append(options["cmd"])
    stub.OpaqueFunction.side_effect = lambda function: later.append(function)
    stub.LaunchConfiguration.side_effect = lambda name: MagicMock(
        perform=lambda _context: values.get(name)
    )
    for name in ("launch", "launch_ros"):
        for module in ("", ".actions", ".substitutions"):
            monkeypatch.setitem(sys.modules, name + module, stub)
    runpy.run_path(str(ROOT / "launch" / "cell.launch.py"))["generate_launch_description"]()
    for function in later:
        function(None)
    ((_, _, module, told, *names),) = watched
    assert (module, told) == ("rotcal_ros.nodes.readiness", place)
    assert names == [node["executable"] for node in started]
    return started


def test_the_page_of_interfaces_has_a_row_for_every_node():
    page = (ROOT / "docs" / "interfaces.md").read_text()
    for name in EXECUTABLES:
        assert page.count(f"\n| `{name}`") >= 2, name
