"""Settings of every controller are those that its page names."""

import re
from dataclasses import MISSING
from pathlib import Path

import pytest
from compensation_examples import d4_table

from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.foundation.settings import declarations

DOCS = Path(__file__).parents[2] / "docs" / "controllers.md"
NUMBER = r"[-+\d.e]+"
WORDS = {"empty": "", "none": None, "true": True, "false": False}


def documented(name):
    """Yield name, default and range in words of every setting of a controller."""
    section = DOCS.read_text().split(f"(`{name}`)")[1].split("\n## ")[0]
    for line in section.splitlines():
        if match := re.fullmatch(r"  \* `(\w+)` = (\S+?)(?: \(([^)]*)\))?: .*", line):
            yield match.groups()


def limits(words):
    """Return minimum, maximum and choices of "0 .. 7", "at least 3", "this or that"."""
    if words is None:
        return None, None, ()
    if match := re.fullmatch(rf"({NUMBER}) \.\. ({NUMBER})", words):
        return float(match[1]), float(match[2]), ()
    if match := re.fullmatch(rf"at least ({NUMBER})", words):
        return float(match[1]), None, ()
    return None, None, tuple(words.split(" or "))


@pytest.mark.parametrize("name", controller_names())
def test_the_settings_of_a_controller_are_as_documented(name):
    controller = make_controller(name)
    assert controller.resolution(d4_table()) > 0.0  # it works as it is
    declared = {one.name: one for one in declarations(type(controller))}
    page = {setting: rest for setting, *rest in documented(name)}
    assert list(page) == list(declared)
    for setting, (default, words) in page.items():
        one = declared[setting]
        minimum, maximum, choices = limits(words)
        assert (one.info.minimum, one.info.maximum) == (minimum, maximum), setting
        assert one.info.choices == choices, setting
        assert one.default is not MISSING
        if one.kind in (int, float) and default != "none":
            assert one.default == float(default), setting
        else:
            assert one.default == WORDS.get(default, default), setting
