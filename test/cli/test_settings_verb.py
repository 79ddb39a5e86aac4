"""``rotcal settings`` prints what configurations are checked against."""

import json

import pytest
from click.testing import CliRunner
from settings_page import rows

from rotcal_ros.cli.main import rotcal

METHODS = ("ball_plate", "plane_mirror", "tracer_multistation", "tracer_six")


def run(*arguments, **env):
    return CliRunner().invoke(rotcal, ["settings", *arguments], prog_name="rotcal", env=env)


@pytest.mark.parametrize("method", METHODS)
def test_a_method_has_its_settings_and_the_shared_ones_as_the_page_has_them(method):
    groups = json.loads(run(method, "--json").stdout)["groups"]
    printed = {setting["name"]: setting for group in groups for setting in group["settings"]}
    page = rows() | rows(method)
    assert printed.keys() == {n for n in page if "." in n and not n.startswith("reading.")}
    for name, setting in printed.items():
        assert setting["kind"] == page[name].kind
        assert setting["required"] == page[name].required


def test_a_range_a_default_and_a_unit_by_hand():
    found = json.loads(run("tracer_multistation", "--group", "capture", "--json").stdout)
    (group,) = found["groups"]
    wait = next(s for s in group["settings"] if s["name"] == "capture.step_timeout_s")
    assert (wait["minimum"], wait["maximum"], wait["default"]) == (0.01, 86400, 30)
    assert wait["meaning"].startswith("s, ")


def test_without_a_method_all_of_them_and_the_goal_are_printed():
    lines = run().stdout.splitlines()
    assert {f"plan of {method}" for method in METHODS} | {"goal of a plan", "capture"} <= {*lines}


@pytest.mark.parametrize("columns", [60, 99])
def test_no_line_is_wider_than_the_terminal_and_nothing_is_cut(columns):
    narrow, wide = (run(COLUMNS=str(width)).stdout for width in (columns, 1000))
    assert max(map(len, narrow.splitlines())) <= columns
    assert narrow.split() == wide.split()


def test_a_setting_that_must_be_given_says_so():
    assert "must be given" in run("ball_plate", "--group", "plan").stdout


def test_a_misspelt_name_gets_the_nearest_one():
    for arguments, hint in (
        (["ball_plat"], "did you mean 'ball_plate'?"),
        (["ball_plate", "--group", "captur"], "did you mean 'capture'?"),
    ):
        ran = run(*arguments)
        assert ran.exit_code == 2
        assert hint in ran.stderr
