"""The page of settings says what the declarations say."""

import runpy
from pathlib import Path

import pytest

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.configuration import GROUPS, settings_classes
from rotcal_ros.methods.method import own_settings
from rotcal_ros.methods.tracer.design.settings import TracerDesignSettings

ROOT = Path(__file__).parents[1]


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
    for declared in declarations(TracerDesignSettings):
        assert f"| `{declared.name}` |" in text


@pytest.mark.parametrize("name", method_names())
def test_what_is_told_without_a_method_is_what_the_method_takes(name, monkeypatch):
    told = own_settings(name)
    assert told == find_method(name).own_settings
    monkeypatch.setattr(plugins, "METHOD_SETTINGS", "nobody.registers_this")
    assert own_settings(name) == told  # a package may leave that entry out
