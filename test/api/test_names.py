"""The names of the front door: one list in code, types and page, and loaded when used."""

import ast
import json
import pkgutil
import pydoc
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import rotcal_ros as rc
from rotcal_ros.foundation.plugins import FUNCTIONS, INDEX, names

ROOT = Path(__file__).parents[2]
OF_PACKAGES = {
    name for p in json.loads(INDEX.read_text()).values() for name in p.get(FUNCTIONS, ())
}
OF_PACKAGES |= {*names(FUNCTIONS)}
"""Names that packages beside the core add, where they are installed."""
HEAVY = ("numpy", "scipy", "yaml", "matplotlib", "rosbags", "rclpy")


def in_fresh_process(code):
    """Return what a new interpreter prints."""
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return run.stdout.split()


def test_the_import_loads_next_to_nothing():
    new = in_fresh_process(
        "import sys; import importlib; before = set(sys.modules); import rotcal_ros; "
        "print(*sorted(set(sys.modules) - before))"
    )
    assert new == ["rotcal_ros"]


@pytest.mark.parametrize("name", ["RotcalError", "ARCSEC", "unit_of"])
def test_a_light_name_stays_light(name):
    loaded = in_fresh_process(f"import sys, rotcal_ros; rotcal_ros.{name}; print(*sys.modules)")
    assert not set(HEAVY) & set(loaded)


def test_a_solve_of_a_bag_loads_no_simulation_no_figures_and_no_reader_of_tables():
    loaded = in_fresh_process(
        "import sys; from pathlib import Path; "
        "from rotcal_ros.recordings.inputs import MeasurementInput as Bag; "
        "Bag(Path('examples/data/ball_plate_bag')).read().solve(); print(*sys.modules)"
    )
    assert "rotcal_ros.methods.ball_plate.method" in loaded
    unused = (
        "simulation.table",
        "ball_plate.simulation",
        "figures",
        "measurements",
        "disturbance",
    )
    assert not {f"rotcal_ros.methods.{name}" for name in unused} & set(loaded)


@pytest.mark.parametrize("name", [name for name in rc.__all__ if name != "ros"])
def test_every_name_is_there_and_says_what_it_is(name):
    value = getattr(rc, name)
    assert name in vars(rc)  # found once
    if not isinstance(value, float):
        assert value.__doc__.strip()


def test_no_name_hides_a_room():
    rooms = {module.name for module in pkgutil.iter_modules(rc.__path__)}
    assert rooms & set(rc.__all__) <= {"ros"}


def test_a_type_checker_sees_the_same_names_at_the_same_places():
    tree = ast.parse((ROOT / "rotcal_ros" / "__init__.pyi").read_text())
    seen = {
        alias.asname: f"{node.module}.{alias.name}"
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module.startswith("rotcal_ros")
        for alias in node.names
    }
    places = {name: f"rotcal_ros.{module}.{name}" for name, module in rc._PLACES.items()}
    places |= {name: f"rotcal_ros.{module}" for name, module in rc._MODULES.items()}
    assert seen == places
    declared = {node.target.id for node in tree.body if isinstance(node, ast.AnnAssign)}
    assert declared == {"__all__", "__version__", *OF_PACKAGES}


def test_the_page_lists_every_name():
    page = (ROOT / "docs" / "api.md").read_text()
    named = set(re.findall(r"`(?:rc\.)?(\w+)", page))
    assert {*rc.__all__, *OF_PACKAGES} - named == set()
    filled = runpy.run_path(str(ROOT / "scripts" / "api_page.py"))["filled"](page)
    told = re.findall(r"^\| `rc\.(\w+)` \| \S.*\. \|$", filled, re.M)
    assert sorted(told) == sorted({*rc.__all__} - {"ARCSEC", "DEGREE", "MICROMETRE"})


def test_dir_and_help_show_the_names():
    assert set(rc.__all__) <= set(dir(rc))
    assert "read_bag" in pydoc.render_doc(rc)


def test_a_misspelt_name_is_no_attribute():
    with pytest.raises(AttributeError, match="no attribute 'read_bags'"):
        rc.read_bags  # noqa: B018


def test_without_ros_the_submodule_says_what_is_missing():
    code = (
        "import sys; sys.modules['rclpy'] = sys.modules['rotcal_ros.ros'] = None\n"
        "import rotcal_ros\n"
        "try: rotcal_ros.ros\n"
        "except AttributeError as error: print(error)"
    )
    text = " ".join(in_fresh_process(code))
    assert "rotcal_ros.ros needs ROS 2" in text
    assert "source a workspace" in text
