"""The package as a whole: what several files say about it must be one story."""

import ast
import re
import runpy
from configparser import ConfigParser
from importlib import metadata, util
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

import rotcal_ros

ROOT = Path(__file__).parents[1]
MANIFESTS = [ROOT / "package.xml", ROOT / "msg_defs" / "package.xml"]
MAX_LINES = 400
TEXT_FILES = sorted(
    path
    for pattern in ("rotcal_ros/**/*.py", "test/**/*.py", "benchmarks/*.py", "scripts/*", "*.py")
    for path in ROOT.glob(pattern)
    if path.is_file() and "__pycache__" not in path.parts
)
PINS = {
    match[1].lower()
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if (match := re.match(r"([\w.-]+)==[\w.]+( ; python_version [<>]=? \"3\.\d+\")?$", line))
}


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda path: path.parent.name)
def test_manifests_are_valid_and_agree_with_the_package(manifest):
    package = parse_package(manifest)
    package.validate()
    assert package.version == rotcal_ros.__version__
    assert package.licenses == ["Apache-2.0"]
    assert [m.email for m in package.maintainers] == ["maintainers@rotcal.invalid"]


def test_the_installed_package_agrees_with_the_source():
    installed = metadata.metadata("rotcal_ros")
    assert installed["Version"] == rotcal_ros.__version__
    assert installed["License"] == "Apache-2.0"
    assert installed["Maintainer-email"] == "maintainers@rotcal.invalid"


def test_the_licence_is_the_apache_licence():
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text


def test_the_changelog_begins_with_this_version():
    versions = re.findall(r"^(\d+\.\d+\.\d+) \(", (ROOT / "CHANGELOG.rst").read_text(), re.M)
    assert versions[0] == rotcal_ros.__version__


def test_every_direct_dependency_is_pinned():
    required = {
        re.match(r"[\w.-]+", requirement)[0].lower()
        for requirement in metadata.requires("rotcal_ros")
    }
    assert required - PINS == set()


def test_every_line_of_the_constraints_is_a_pin():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    names = {re.split(r"[=<> ]", line)[0].lower() for line in lines if line and line[0] != "#"}
    assert names == PINS


def test_every_command_leads_to_a_function():
    scripts = metadata.entry_points(group="console_scripts")
    ours = [script for script in scripts if script.value.startswith("rotcal_ros.")]
    assert {"rotcal", "planner", "capture", "solver", "recorder", "simulated_cell"} <= {
        script.name for script in ours
    }
    for script in ours:
        module, function = script.value.split(":")
        found = util.find_spec(module)
        assert found, script.value
        tree = ast.parse(Path(found.origin).read_text())
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_data_file_of_the_package_is_installed(monkeypatch):
    monkeypatch.chdir(ROOT)
    setup = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: setup.update(arguments))
    runpy.run_path("setup.py")
    patterns = setup["package_data"][""]
    data = [
        path.relative_to(ROOT)
        for path in (ROOT / "rotcal_ros").rglob("*")
        if path.is_file() and path.suffix not in {".py", ".pyc"}
    ]
    assert data
    assert [path for path in data if not any(path.match(pattern) for pattern in patterns)] == []


def test_ros_run_finds_the_executables():
    settings = ConfigParser()
    settings.read(ROOT / "setup.cfg")
    assert settings["develop"]["script_dir"] == "$base/lib/rotcal_ros"
    assert settings["install"]["install_scripts"] == "$base/lib/rotcal_ros"
    assert (ROOT / "resource" / "rotcal_ros").is_file()


def test_the_manifest_names_every_ros_package_that_is_imported():
    imported = {
        name.split(".")[0]
        for path in (ROOT / "rotcal_ros" / "nodes").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module]
            if isinstance(node, ast.ImportFrom) and node.module
            else []
        )
    }
    of_ros = {n for n in imported if re.search(r"^(rclpy|.*_msgs|.*_interfaces|.*_srvs)$", n)}
    assert "rclpy" in of_ros
    assert of_ros <= {dependency.name for dependency in parse_package(MANIFESTS[0]).exec_depends}


def test_every_interface_is_built():
    listed = set(
        re.findall(
            r'"((?:msg|srv|action)/\w+\.\w+)"', (ROOT / "msg_defs/CMakeLists.txt").read_text()
        )
    )
    found = {
        str(path.relative_to(ROOT / "msg_defs"))
        for kind in ("msg", "srv", "action")
        for path in (ROOT / "msg_defs" / kind).iterdir()
    }
    assert listed == found


@pytest.mark.parametrize("path", TEXT_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_file_is_too_long_to_read(path):
    assert len(path.read_text().splitlines()) <= MAX_LINES
