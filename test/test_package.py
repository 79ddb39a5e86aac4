"""The package as a whole: what several files say about it must be one story."""

import ast
import json
import os
import re
import runpy
import subprocess
import sys
from collections import defaultdict
from configparser import ConfigParser
from importlib import metadata, util
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package
from packaging.markers import Marker
from packaging.utils import canonicalize_name

import rotcal_ros
from rotcal_ros.foundation.middleware import SUPPORTED

ROOT = Path(__file__).parents[1]
RELEASE = runpy.run_path(str(ROOT / "scripts" / "release.py"))
BESIDE = sorted(path.parent for path in ROOT.glob("packages/*/package.xml"))
"""The folders of the packages beside the core."""
with_all = pytest.mark.skipif(
    any(metadata.version(path.name) != rotcal_ros.__version__ for path in BESIDE),
    reason="a package beside the core is hidden by scripts/alone.py",
)
MANIFESTS = [
    ROOT / "package.xml", ROOT / "msg_defs" / "package.xml", *(p / "package.xml" for p in BESIDE)
]  # fmt: skip
CHANGELOGS = [path.with_name("CHANGELOG.rst") for path in MANIFESTS]
ROSDEP_KEYS = {
    "click": "python3-click",
    "jinja2": "python3-jinja2",
    "lz4": "mcap-ros2-support",  # comes with mcap
    "markupsafe": "python3-jinja2",  # comes with jinja2
    "matplotlib": "python3-matplotlib",
    "mcap": "mcap-ros2-support",  # there is no key for mcap alone
    "numpy": "python3-numpy",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "uvicorn": "python3-uvicorn",
    "threadpoolctl": "mcap-ros2-support",  # there is no key: docs/install.md
    "yaml": "python3-yaml",
    "zstandard": "mcap-ros2-support",  # comes with mcap
}
WITHOUT_KEYS = {"alembic", "google", "pyarrow", "python_calamine", "sqlalchemy", "starlette"}
"""What pip alone brings: verbs that need it say so."""
OF_PIP_ALONE = {"mcap-ros2-support", "python3-rosbags-pip"}
OF_THE_CONTROLLER = {"hal", "linuxcnc"}
RECORDED_BY_NAME = {"lifecycle_msgs"}  # types that the recorder meets as text
MAX_LINES = 900
VAGUE = {"said", "told", "made", "still", "one"}
"""Words that name nothing of the field."""
TEXT_FILES = sorted(
    path
    for pattern in (
        "rotcal_ros/**/*.py",
        "packages/**/*.py",
        "test/**/*.py",
        "benchmarks/*.py",
        "scripts/*",
        "*.py",
    )
    for path in ROOT.glob(pattern)
    if path.is_file() and "__pycache__" not in path.parts
)
CONSTRAINTS = sorted(ROOT.glob("constraints*.txt"))
PIN = re.compile(r"([\w.-]+)==[\w.]+( ; python_version [<>]=? \"3\.\d+\")?$")
PINS = {
    match[1].lower()
    for path in CONSTRAINTS
    for line in path.read_text().splitlines()
    if (match := PIN.match(line))
}


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda path: path.parent.name)
def test_manifests_are_valid_and_agree_with_the_package(manifest):
    package = parse_package(manifest)
    package.validate()
    assert package.version == rotcal_ros.__version__
    assert package.licenses == ["Apache-2.0"]
    assert [m.email for m in package.maintainers] == ["maintainers@rotcal.invalid"]


each_package = pytest.mark.parametrize("name", ["rotcal_ros", *(path.name for path in BESIDE)])


@with_all
@each_package
def test_the_installed_package_agrees_with_the_source(name):
    installed = metadata.metadata(name)
    assert installed["Version"] == rotcal_ros.__version__
    assert installed["License"] == "Apache-2.0"
    assert installed["Maintainer-email"] == "maintainers@rotcal.invalid"


def test_the_licence_is_the_apache_licence():
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text


def test_every_place_that_states_a_version_states_this_one():
    assert RELEASE["agreed_version"]() == rotcal_ros.__version__


@pytest.mark.parametrize("changelog", CHANGELOGS, ids=lambda path: path.parent.name)
def test_the_changelog_has_the_form_of_catkin_on_its_day(changelog, tmp_path):
    text = changelog.read_text().replace("(unreleased)", "(2026-11-30)")
    (tmp_path / "CHANGELOG.rst").write_text(text)
    read = get_changelog_from_path(str(tmp_path), changelog.parent.name)
    version, _, content = next(iter(read.foreach_version(reverse=True)))
    assert (version, *RELEASE["newest_heading"](changelog)[:1]) == (rotcal_ros.__version__,) * 2
    assert content


def test_a_version_is_written_wherever_one_is_stated(tmp_path):
    stated = RELEASE["STATED"]
    for path in stated:
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(path.read_text())
    script = tmp_path / "scripts" / "release.py"
    script.parent.mkdir()
    script.write_text((ROOT / "scripts" / "release.py").read_text())
    run = (sys.executable, script, "--set", "3.2.1")
    subprocess.run((*run[:-1], rotcal_ros.__version__), check=True)  # a day for each changelog
    refused = subprocess.run(run, capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "begin a section '3.2.1 (unreleased)' there" in refused.stderr
    for path in CHANGELOGS:
        copy = tmp_path / path.relative_to(ROOT)
        begun = f"3.2.1 (unreleased)\n------\n* New.\n\n{rotcal_ros.__version__} ("
        copy.write_text(copy.read_text().replace(f"{rotcal_ros.__version__} (", begun, 1))
    subprocess.run(run, check=True)
    texts = {path: (tmp_path / path.relative_to(ROOT)).read_text() for path in stated}
    found = {path: re.search(line, texts[path], re.M)[1] for path, line in stated.items()}
    assert set(found.values()) == {"3.2.1"}
    for path in CHANGELOGS:
        newest, earlier = RELEASE["HEADING"].findall(texts[path])[:2]
        assert newest.startswith("3.2.1 (2")
        assert earlier.startswith(f"{rotcal_ros.__version__} (2")


@with_all
@each_package
def test_every_direct_dependency_is_pinned(name):
    required = {
        re.match(r"[\w.-]+", requirement)[0].lower() for requirement in metadata.requires(name)
    }
    assert required - PINS == {"rotcal_ros"} - {name}


@with_all
@pytest.mark.parametrize("folder", BESIDE, ids=lambda path: path.name)
def test_a_package_beside_the_core_is_whole(folder):
    name = folder.name
    assert f"rotcal_ros=={rotcal_ros.__version__}" in metadata.requires(name)
    assert parse_package(folder / "package.xml").name == name
    for part in ("README.md", "setup.cfg", f"resource/{name}", f"{name}/py.typed", "test"):
        assert (folder / part).exists(), part
    settings = ConfigParser()
    settings.read(folder / "setup.cfg")
    assert settings["develop"]["script_dir"] == f"$base/lib/{name}"
    assert settings["install"]["install_scripts"] == f"$base/lib/{name}"


@with_all
def test_errors_know_which_package_brings_what():
    index = runpy.run_path(str(ROOT / "scripts" / "package_index.py"))
    assert json.loads(index["INDEX"].read_text()) == index["index"]()


@pytest.mark.parametrize("path", CONSTRAINTS, ids=lambda path: path.stem)
def test_every_line_of_the_constraints_is_a_pin(path):
    lines = [line for line in path.read_text().splitlines() if line and line[0] != "#"]
    assert [line for line in lines if not PIN.match(line)] == []
    of_ros = {line.startswith("ros-") for line in lines}
    assert of_ros == {path.stem != "constraints"}


@pytest.mark.parametrize("distribution", SUPPORTED)
def test_every_supported_distribution_pins_all_of_ros(distribution, setup_py):
    extras = setup_py["extras_require"]
    wanted = [*extras["ros"], *extras["build"], *extras[f"build-{distribution}"]]
    wheels = {name.partition("[")[0] for name in wanted if name.startswith("ros-")}
    lines = (ROOT / f"constraints-{distribution}.txt").read_text().splitlines()
    pinned = {line.partition("==")[0] for line in lines if line.startswith("ros-")}
    assert pinned == wheels | {"ros-rmw-fastrtps-cpp"}  # an extra of ros-rclpy


LOCKED = re.compile(
    r"# for: (?P<parts>.+)\n(?P<name>[\w.-]+)==(?P<version>\S+)(?: ; (?P<marker>[^\\]+?))? \\\n"
    r"(?P<hashes>(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)"
)


def locked(distribution):
    """Return (parts, name, version, marker) of all packages of a lock, and what else it holds."""
    text = (ROOT / "locks" / f"{distribution}.txt").read_text()
    found = [
        (m["parts"].split(), canonicalize_name(m["name"]), m["version"], m["marker"])
        for m in LOCKED.finditer(text)
    ]
    return found, LOCKED.sub("", text)


@pytest.mark.parametrize("distribution", SUPPORTED)
def test_a_lock_has_a_version_and_hashes_of_every_package_and_names_no_registry(distribution):
    found, rest = locked(distribution)
    assert len(found) > 200
    assert all(line.startswith("# ") for line in rest.splitlines())
    assert "://" not in rest


@with_all
@pytest.mark.parametrize("python", ["3.10", "3.11", "3.12", "3.13", "3.14"])
@pytest.mark.parametrize("distribution", SUPPORTED)
def test_a_lock_has_what_each_extra_needs_as_it_is_pinned(distribution, python, setup_py):
    found, _ = locked(distribution)
    here = {"python_version": python, "python_full_version": f"{python}.9", "extra": ""}
    here |= {"sys_platform": "linux", "platform_machine": "x86_64"}
    beside = {
        path.name: [t for t in metadata.requires(path.name) if not t.startswith("rotcal_")]
        for path in BESIDE
    }

    def fits(marker):
        return marker is None or Marker(marker).evaluate(here)

    there = [(parts, name, version) for parts, name, version, marker in found if fits(marker)]
    versions = {name: version for _, name, version in there}
    assert len(versions) == len(there)  # one version of each
    pins = [
        line.split(" ; ")
        for path in (ROOT / "constraints.txt", ROOT / f"constraints-{distribution}.txt")
        for line in path.read_text().splitlines()
        if "==" in line
    ]
    for pin, *marker in pins:
        name, _, version = pin.partition("==")
        if canonicalize_name(name) in versions and fits(*marker or [None]):
            assert versions[canonicalize_name(name)] == version
    others = {f"build-{other}" for other in SUPPORTED} - {f"build-{distribution}"}
    wanted = {"core": setup_py["install_requires"], **setup_py["extras_require"], **beside}
    for part in wanted.keys() - {"mutants", "peers", "release", *others}:
        named = {canonicalize_name(re.match(r"[\w.-]+", text)[0]) for text in wanted[part]}
        assert named <= {name for parts, name, _ in there if part in parts}, part


def test_the_base_of_the_container_and_the_actions_of_ci_are_pinned():
    actions = [
        line.split("uses:")[1]
        for path in (ROOT / ".github").glob("workflows/*.y*ml")
        for line in path.read_text().splitlines()
        if "uses:" in line
    ]
    assert actions
    assert all(re.fullmatch(r" \S+@[0-9a-f]{40} # v[\d.]+", action) for action in actions)
    base = re.search(r"^ARG BASE=(.+)$", (ROOT / "Dockerfile").read_text(), re.M)[1]
    assert re.search(r":\w+-\d{8}-slim$|@sha256:[0-9a-f]{64}$", base)


def test_the_environment_is_found_by_ros_run_and_launch(setup_py):
    """As ament_index_python looks: the marker, then share/PACKAGE and lib/PACKAGE."""
    prefixes = [Path(sys.prefix), *map(Path, os.environ.get("AMENT_PREFIX_PATH", "").split(":"))]
    marker = Path("share", "ament_index", "resource_index", "packages", "rotcal_ros")
    prefix = next((place for place in prefixes if (place / marker).exists()), None)
    if prefix is None:
        pytest.skip("this environment was not made by scripts/setup.sh")
    share, programs = prefix / "share" / "rotcal_ros", prefix / "lib" / "rotcal_ros"
    assert (share / "package.xml").is_file()
    assert (share / "launch" / "cell.launch.py").is_file()
    assert (share / "config" / "tracer_demo.yaml").is_file()
    assert [name for name in setup_py["NODES"] if not os.access(programs / name, os.X_OK)] == []


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


@pytest.fixture
def setup_py(monkeypatch):
    """Return what setup.py gives to setup(), and its names."""
    return given_to_setup(monkeypatch, ROOT)


def given_to_setup(monkeypatch, folder):
    monkeypatch.chdir(folder)
    given = {}
    monkeypatch.setattr("setuptools.setup", lambda **arguments: given.update(arguments))
    return runpy.run_path("setup.py") | given


def test_every_shared_folder_exists_and_is_installed(setup_py):
    shared = {f"share/rotcal_ros/{folder}": ROOT / folder for folder in setup_py["SHARED"]}
    assert [folder for folder in shared.values() if not folder.is_dir()] == []
    assert shared.keys() <= {destination for destination, _files in setup_py["data_files"]}


@each_package
def test_every_data_file_of_the_package_is_installed(name, monkeypatch):
    place = ROOT if name == "rotcal_ros" else ROOT / "packages" / name
    patterns = given_to_setup(monkeypatch, place)["package_data"][""]
    data = [
        path.relative_to(place)
        for path in (place / name).rglob("*")
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


@pytest.fixture(scope="module")
def code():
    """Return file -> all nodes of its tree, of what is installed."""
    folders = (ROOT / "rotcal_ros", ROOT / "launch", *(path / path.name for path in BESIDE))
    files = (path for folder in folders for path in folder.rglob("*.py"))
    trees = {path.relative_to(ROOT): ast.parse(path.read_text()) for path in sorted(files)}
    return {path: [*ast.walk(tree)] for path, tree in trees.items()}


@each_package
def test_the_manifest_names_what_is_imported_and_nothing_else(name, code, monkeypatch):
    place = ROOT if name == "rotcal_ros" else ROOT / "packages" / name
    below = ("rotcal_ros/", "launch/") if place == ROOT else (f"packages/{name}/",)
    extras = given_to_setup(monkeypatch, place).get("extras_require", {})
    with_own_errors = ("parquet", "many", "opcua", "ads", "dcc", "page")
    names = (name for extra in with_own_errors for name in extras.get(extra, ()))
    optional = {*(name.replace("-", "_") for name in names), *OF_THE_CONTROLLER} - {"uvicorn"}
    imported = {
        name.split(".")[0]
        for path, nodes in code.items()
        if str(path).startswith(below)
        for node in nodes
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module]
            if isinstance(node, ast.ImportFrom) and node.module and not node.level
            else []
        )
    }
    foreign = imported - set(sys.stdlib_module_names) - optional - WITHOUT_KEYS - {name}
    needed = {ROSDEP_KEYS.get(name, name) for name in foreign}
    assert needed & RECORDED_BY_NAME == set()
    named = {dependency.name for dependency in parse_package(place / "package.xml").exec_depends}
    assert named == needed | (RECORDED_BY_NAME if place == ROOT else set())


@pytest.mark.parametrize(("asked", "found"), [({}, set()), ({"ROTCAL_PIP": "1"}, OF_PIP_ALONE)])
def test_keys_of_pip_alone_are_asked_for_only_by_who_wants_them(asked, found):
    """As bloom and rosdep read it (REP 149); bloom refuses keys that only pip can install."""
    package = parse_package(MANIFESTS[0])
    package.evaluate_conditions(asked)
    named = {d.name for d in package.exec_depends if d.evaluated_condition}
    assert named & OF_PIP_ALONE == found
    assert "python3-numpy" in named


def test_every_key_is_one_of_rosdep(tmp_path):
    """Nobody looks inside a package for another one: the second one needs a link."""
    keys = runpy.run_path(str(ROOT / "scripts" / "check_keys.py"))
    (tmp_path / "rotcal_ros").symlink_to(ROOT)
    assert keys["wrong"](tmp_path, {})[1] == ["rotcal_ros: no rosdep key 'rotcal_msgs'"]
    (tmp_path / "msg_defs").symlink_to(ROOT / "msg_defs")
    (tmp_path / "packages").symlink_to(ROOT / "packages")
    names = sorted(["rotcal_msgs", "rotcal_ros", *(path.name for path in BESIDE)])
    assert keys["wrong"](tmp_path, {}) == (names, [])
    asked = {d.name for m in MANIFESTS for d in parse_package(m).exec_depends}
    assert asked & {k for k, rest in keys["known_keys"]().items() if "pip" in rest} >= OF_PIP_ALONE


def test_the_workspace_file_and_the_recipe_name_the_same_folders():
    (name,) = yaml.safe_load((ROOT / "rotcal.repos").read_text())["repositories"]
    recipe = (ROOT / "docs" / "install.md").read_text()
    for line in ("vcs import src < rotcal.repos", f"ln -s {name}/msg_defs {name}/packages src"):
        assert line in recipe
        assert line in (ROOT / "rotcal.repos").read_text()


def test_the_hooks_are_the_linters_of_make_lint():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    recipe = (ROOT / "Makefile").read_text().split("\nlint:")[1].split("\n\n")[0]
    linters = [line.strip().replace("$(BIN)", ".venv/bin") for line in recipe.splitlines()[1:]]
    assert [hook["entry"] for hook in hooks] == linters


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


def test_no_file_is_too_long_to_read():
    assert [path for path in TEXT_FILES if len(path.read_text().splitlines()) > MAX_LINES] == []


def _given_names(nodes):
    """Yield the names that a file gives: variables, attributes, arguments, functions, classes."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name


def test_names_come_from_the_field(code):
    """A name says what it holds."""
    vague = [
        f"{path}: {name}"
        for path, nodes in code.items()
        for name in _given_names(nodes)
        if name.strip("_").lower() in VAGUE
    ]
    assert vague == []


def test_a_vague_name_is_found_wherever_it_is_given():
    text = """
for one in told: self.still = lambda made: one
def said(): ...
"""
    assert {*_given_names(ast.walk(ast.parse(text)))} & VAGUE == VAGUE - {
        "told"
    }  # told is only read


def test_a_class_name_means_one_thing(code):
    places = defaultdict(list)
    for path, nodes in code.items():
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
