"""Without a package all else works, and a name that it brings is named with what to install."""

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from rotcal_ros.foundation import plugins

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
ALONE = runpy.run_path(str(ROOT / "scripts" / "alone.py"))
INDEX = json.loads(plugins.INDEX.read_text("utf-8"))
RESULT = ROOT / "examples" / "data" / "result_tracer.json"
BAG = ROOT / "examples" / "data" / "ball_plate_bag"
ROTCAL = ("-m", "rotcal_ros.cli.main")
CHANGED = """
import sys
from pathlib import Path
from rotcal_ros.methods.configuration import changed, read_configuration
changed(read_configuration(Path(sys.argv[1])), sys.argv[2:])
"""


FIRST_STEP = """
import sys
from pathlib import Path
from rotcal_ros.methods import prepare, read_configuration
calibration = prepare(read_configuration(Path(sys.argv[1])))
print(calibration.policy(calibration.first_run()).choose().reason)
"""


@pytest.fixture
def without(tmp_path):
    """Return what runs Python as if no package beside the core had been installed."""
    place = tmp_path / "hiding"
    place.mkdir()
    ALONE["hide"](place)

    def run(*arguments):
        path = os.pathsep.join([str(place), *filter(None, sys.path)])
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=place, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
        )  # fmt: skip

    return run


@pytest.mark.parametrize("arguments", [["--help"], ["settings"]])
def test_the_core_alone_works(without, arguments):
    ran = without(*ROTCAL, *arguments)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "dme" not in ran.stdout


def test_the_core_alone_solves_propagates_and_reports(without, tmp_path):
    solved = without(*ROTCAL, "solve", BAG, "--json")
    assert json.loads(solved.stdout)["verdict"] == "ok", solved.stderr
    trials = without(*ROTCAL, "uncertainty", BAG, "--trials", 100)
    assert trials.returncode == 0, trials.stderr
    report = without(*ROTCAL, "report", BAG, "-o", tmp_path / "report.html")
    assert report.returncode == 0, report.stderr
    missing = without(*ROTCAL, "report", RESULT, "--dcc")
    assert missing.returncode == 2
    assert re.fullmatch(
        r"rotcal: a certificate needs 'dcc'; its package is not installed: pip install \w+\n",
        missing.stderr,
    )


def test_the_core_alone_plans_and_measures_until_its_goal_is_reached(without):
    ordered = without(*ROTCAL, "plan", "order", ROOT / "config" / "ball_plate.yaml")
    assert "order interleaved: 876 balls" in ordered.stderr
    listed = without(*ROTCAL, "plan", "--help").stdout
    assert re.findall(r"^  ([a-z]+)  ", listed, re.M) == ["add", "order", "power", "reliability"]
    chosen = without("-c", FIRST_STEP, ROOT / "config" / "tracer_demo.yaml")
    assert (chosen.stdout, chosen.stderr) == ("first sweep\n", "")


@pytest.mark.parametrize(
    ("package", "verb"),
    [(name, verb) for name in INDEX for verb in INDEX[name].get(plugins.VERBS, ())],
)
def test_without_its_package_a_verb_is_told_with_what_to_install(without, package, verb):
    refused = without(*ROTCAL, verb)
    last = refused.stderr.splitlines()[-1]
    assert last == f"Error: no verb {verb!r}; its package is not installed: pip install {package}"
    assert refused.returncode == 2


BROUGHT = [
    (group, name, package)
    for package, brought in INDEX.items()
    for group in (plugins.PLANS, plugins.CONTROLLERS, plugins.STORES, plugins.SETTINGS)
    for name in brought.get(group, ())
]
OF_SETTINGS = {
    plugins.CONTROLLERS: ("bridge.controller={0}", "'{0}' is none of csv, linuxcnc"),
    plugins.STORES: ("bridge.transport={0}", "'{0}' is none of folder"),
    plugins.SETTINGS: ("{0}.name=1", "unknown group '{0}'"),
}
"""How a setting names one of a group, and what an error says of it."""


def hint(package):
    return f"; its package is not installed: pip install {package}"


def of(group):
    """Return the parameters of a test with each name of a group and its package."""
    rows = [(name, package) for of_group, name, package in BROUGHT if of_group == group]
    return pytest.mark.parametrize(("name", "package"), rows)


@of(plugins.PLANS)
def test_without_its_package_a_plan_is_told_with_what_to_install(without, name, package):
    refused = without(*ROTCAL, "plan", name, "--need", "ECC=1", "GOAL.yaml")
    assert refused.stderr.splitlines()[-1] == f"Error: no plan {name!r}{hint(package)}"
    assert refused.returncode == 2


@of(plugins.CONTROLLERS)
def test_without_its_package_a_controller_is_told_with_what_to_install(
    without, tmp_path, name, package
):
    asked = ("--to", name, "--replace", "-o", tmp_path)
    refused = without(*ROTCAL, "export", RESULT, *asked)
    assert refused.returncode == 2
    assert refused.stderr == f"rotcal: unknown controller {name!r}{hint(package)}\n"


def test_the_core_alone_exports(without, tmp_path):
    def export(name):
        return without(*ROTCAL, "export", RESULT, "--to", name, "--replace", "-o", tmp_path)

    assert export("csv").returncode == 0
    assert "did you mean 'linuxcnc'" in export("linuxcmc").stderr


@pytest.mark.parametrize(
    ("name", "package"),
    [(name, p) for p, brought in INDEX.items() for name in brought.get(plugins.FUNCTIONS, ())],
)
def test_without_its_package_a_name_of_the_front_door_is_told_with_what_to_install(
    without, name, package
):
    called = without("-c", f"import rotcal_ros as rc; rc.{name}")
    text = called.stderr.splitlines()[-1]
    assert text == f"AttributeError: module 'rotcal_ros' has no attribute {name!r}{hint(package)}"


@pytest.mark.parametrize(
    ("group", "name", "package"), [row for row in BROUGHT if row[0] in OF_SETTINGS]
)
def test_without_its_package_a_setting_is_told_with_what_to_install(without, group, name, package):
    change, words = OF_SETTINGS[group]
    config = ROOT / "config" / "tracer_demo.yaml"
    refused = without("-c", CHANGED, config, change.format(name))
    assert refused.stderr.splitlines()[-1].endswith(f"{words.format(name)}{hint(package)}")
