"""The page of settings says what the declarations say."""

import re
import runpy
from copy import deepcopy
from dataclasses import MISSING, dataclass
from pathlib import Path

import pytest

from rotcal_ros.foundation import plugins, settings
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import declarations, load
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.calibration import prepare_to_measure
from rotcal_ros.methods.configuration import (
    GROUPS,
    dump_configuration,
    parse_configuration,
    raw_groups,
    read_configuration,
    settings_classes,
)
from rotcal_ros.methods.method import own_settings
from rotcal_ros.methods.settings_reference import (
    Section,
    all_sections,
    first_settings,
    goal_sections,
    method_sections,
    unit_and_meaning,
)

ROOT = Path(__file__).parents[1]
PAGE = runpy.run_path(str(ROOT / "scripts" / "settings_page.py"))["page"]()
BUILT_IN = (
    "angle_comparison", "ball_plate", "plane_mirror", "table_balls", "tracer_multistation",
    "tracer_six",
)  # fmt: skip
REAL = ("angle_comparison", "ball_plate", "plane_mirror", "table_balls", "tracer", "tracer_six")
"""The configurations of real cells in ``config``, one of each method."""
UNITS = {
    "m", "mm", "um", "nm", "m/m", "um/m", "rad", "deg", "arcsec", "s", "days", "Hz", "m/s",
    "m/s^2", "deg/s", "deg/s^2", "um/h", "arcsec/h", "degC", "K", "K/h", "um/K", "um/(m*K)", "Pa",
    "umol/mol", "bytes",
}  # fmt: skip


def test_every_setting_of_every_method_stands_there_with_its_meaning():
    for name in ("ball_plate", "plane_mirror", "tracer_multistation"):
        assert name in method_names()
        classes = settings_classes(find_method(name))
        assert tuple(classes) == GROUPS
        for group, cls in classes.items():
            for declared in declarations(cls):
                *places, last = declared.name.split(".")
                alike = "".join(rf"\.(?:{place}|\*)" for place in places)
                assert re.search(rf"`{group}{alike}\.{last}`", PAGE)
                assert declared.info.description


def test_what_is_for_experts_stands_at_the_end_of_the_page_and_nothing_else_does():
    begin, end = PAGE.split("\n## For experts\n")
    of_goals = [["need_arcsec"], ["exchanges"]] if goal_sections() else [[], []]
    for name in ("capture.window_samples", "solver.way", "simulation.seed", *of_goals[0]):
        assert f"`{name}`" in begin
        assert f"`{name}`" not in end
    for name in (
        "capture.spike_floor_m",
        "solver.uneven_drift_std_arcsec",
        "simulation.hold_s",
        *of_goals[1],
    ):
        assert f"`{name}`" not in begin
        assert f"`{name}`" in end


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_method_asks_for_no_more_than_people_can_answer(name):
    sections = method_sections(name)
    assert sections[-1].group == "simulation"
    assert sum(len(section.rows(expert=False)) for section in sections) <= 120
    assert not [n for n, declared in first_settings(sections) if declared.info.expert]


def test_what_several_places_have_alike_is_one_row_that_names_them():
    @dataclass(frozen=True)
    class Place:
        """A place."""

        maker: str = settings.setting("", doc="manufacturer")

    @dataclass(frozen=True)
    class Group:
        """Three places, one of which is for experts."""

        serial: str = settings.setting("", doc="serial number")
        tracer: Place = settings.group(Place)
        mirror: Place = settings.group(Place)
        clock: Place = settings.group(Place, expert=True)

    section = Section("identity", "", Group)
    told = {name: declared.info.description for name, declared in section.rows(expert=False)}
    assert told == {
        "identity.serial": "serial number",
        "identity.*.maker": "manufacturer; *: tracer, mirror",
    }
    assert [name for name, _ in section.rows(expert=True)] == ["identity.clock.maker"]


@pytest.mark.parametrize("name", REAL)
def test_a_real_cell_is_configured_without_what_is_for_experts(name):
    configuration = read_configuration(ROOT / "config" / f"{name}.yaml")
    declared = (pair for s in method_sections(configuration.method.name) for pair in s.settings())
    assert not configuration.given.intersection(n for n, one in declared if one.info.expert)


@pytest.mark.parametrize("name", REAL)
def test_a_file_may_have_every_setting_for_experts(name):
    """Each is read: nonsense in its place is refused by its name."""
    method, given = raw_groups((ROOT / "config" / f"{name}.yaml").read_text(), name)
    for section in method_sections(method):
        for setting_name, declared in section.settings():
            if declared.info.expert:
                values = deepcopy(given.get(section.group, {}))
                *above, last = declared.name.split(".")
                place = values
                for part in above:
                    place = place.setdefault(part, {})
                place[last] = {"no": "value"}
                with pytest.raises(ConfigurationError, match=f"^{setting_name}: expected"):
                    load(section.cls, values, section.group)


def test_every_setting_of_a_goal_stands_there_without_a_group():
    for goal in goal_sections():
        for name, _ in goal.settings():
            assert f"| `{name}` |" in PAGE


@pytest.mark.parametrize("name", method_names())
def test_a_method_has_a_dozen_first_settings_at_most_and_the_page_begins_with_them(name):
    first = [setting for setting, _ in first_settings(method_sections(name))]
    assert 0 < len(first) <= 12
    begin = PAGE.partition("\n## cell\n")[0]
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
