"""The page of settings says what the declarations say."""

import re
import runpy
from dataclasses import MISSING
from pathlib import Path

import pytest

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.calibration import prepare_to_measure
from rotcal_ros.methods.configuration import (
    GROUPS,
    dump_configuration,
    parse_configuration,
    read_configuration,
    settings_classes,
)
from rotcal_ros.methods.method import own_settings
from rotcal_ros.methods.settings_reference import (
    all_sections,
    first_settings,
    goal_sections,
    method_sections,
    unit_and_meaning,
)

ROOT = Path(__file__).parents[1]
REAL = ("ball_plate", "plane_mirror", "tracer", "tracer_six")
"""The configurations of real cells in ``config``, one of each method."""
UNITS = {
    "m", "mm", "um", "nm", "m/m", "um/m", "rad", "deg", "arcsec", "s", "days", "Hz", "m/s",
    "m/s^2", "deg/s", "deg/s^2", "um/h", "arcsec/h", "degC", "K", "K/h", "um/K", "um/(m*K)", "Pa",
    "umol/mol", "bytes",
}  # fmt: skip


def test_the_page_is_current():
    page = runpy.run_path(str(ROOT / "scripts" / "settings_page.py"))["page"]()
    assert (ROOT / "docs" / "settings.md").read_text() == page, "run scripts/settings_page.py"


def test_every_setting_of_every_method_stands_there_with_its_meaning():
    text = (ROOT / "docs" / "settings.md").read_text()
    for name in ("ball_plate", "plane_mirror", "tracer_multistation"):
        assert name in method_names()
        classes = settings_classes(find_method(name))
        assert tuple(classes) == GROUPS
        for group, cls in classes.items():
            for declared in declarations(cls):
                assert f"`{group}.{declared.name}`" in text
                assert declared.info.description


def test_every_setting_of_a_goal_stands_there_without_a_group():
    text = (ROOT / "docs" / "settings.md").read_text()
    (goal,) = goal_sections()
    for name, _ in goal.settings():
        assert f"| `{name}` |" in text


@pytest.mark.parametrize("name", method_names())
def test_a_method_has_a_dozen_first_settings_at_most_and_the_page_begins_with_them(name):
    first = [setting for setting, _ in first_settings(method_sections(name))]
    assert 0 < len(first) <= 12
    begin = (ROOT / "docs" / "settings.md").read_text().partition("\n## cell\n")[0]
    table = begin.partition(f"### First of {name}\n")[2].partition("\n#")[0]
    assert re.findall(r"^\| \**`([\w.]+)`", table, re.MULTILINE) == first


@pytest.mark.parametrize("name", method_names())
def test_what_has_no_default_comes_first(name):
    for _, declared in (pair for section in method_sections(name) for pair in section.settings()):
        assert declared.info.first or declared.default is not MISSING


@pytest.mark.parametrize("name", REAL)
def test_a_real_cell_can_be_measured_with_its_first_settings_alone(name):
    whole = read_configuration(ROOT / "config" / f"{name}.yaml")
    assert not whole.simulated
    groups = {}
    for setting, declared in first_settings(method_sections(whole.method.name)):
        group, _, path = setting.partition(".")
        value, place = whole.group(group), groups.setdefault(group, {})
        *above, last = path.split(".")
        for part in above:
            value, place = getattr(value, part), place.setdefault(part, {})
        value = getattr(value, last)
        place[last] = list(value) if declared.is_list else value
    text = dump_configuration(whole.method.name, groups)
    least = prepare_to_measure(parse_configuration(text)).plan
    most = prepare_to_measure(whole).plan
    assert (least.table_angles, least.targets) == (most.table_angles, most.targets)


def test_units_stand_before_the_first_comma_and_are_those_of_the_names():
    for section in all_sections():
        for name, declared in section.settings():
            unit, meaning = unit_and_meaning(declared)
            assert unit in {"", *UNITS}, name
            assert meaning, name
            last = name.rpartition("_")[2]
            if last in UNITS and not re.search(r"_(per_m|m_s|deg_s)$", name):
                assert unit == last, name


@pytest.mark.parametrize("name", method_names())
def test_what_is_told_without_a_method_is_what_the_method_takes(name, monkeypatch):
    told = own_settings(name)
    assert told == find_method(name).own_settings
    monkeypatch.setattr(plugins, "METHOD_SETTINGS", "nobody.registers_this")
    assert own_settings(name) == told  # a package may leave that entry out
