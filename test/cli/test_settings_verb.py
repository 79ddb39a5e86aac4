"""``rotcal settings`` prints what configurations are checked against."""

import fnmatch
import json
import re
from importlib.metadata import entry_points

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.plugins import GOALS, names

METHODS = (
    "angle_comparison", "ball_plate", "plane_mirror", "table_balls", "tracer_multistation",
    "tracer_six",
)  # fmt: skip


def run(*arguments, **env):
    return CliRunner().invoke(rotcal, ["settings", *arguments], prog_name="rotcal", env=env)


def test_a_range_a_default_and_a_unit_by_hand():
    found = json.loads(run("tracer_multistation", "capture", "--json").stdout)
    (group,) = found["groups"]
    wait = next(s for s in group["settings"] if s["name"] == "capture.step_timeout_s")
    assert (wait["minimum"], wait["maximum"], wait["default"]) == (0.01, 86400, 30)
    assert wait["unit"] == "s"
    assert wait["meaning"].startswith("s, ")


@pytest.mark.parametrize("method", METHODS)
def test_a_method_begins_with_what_has_to_be_stated_and_names_the_others(method):
    """All but those for experts, which it counts; alike ones have one name with a ``*``."""
    groups = json.loads(run(method, "--json").stdout)["groups"]
    first = [s["name"] for group in groups for s in group["settings"] if s["first"]]
    table, more, end = run(method, COLUMNS="1000").stdout.split("\nand ")
    assert re.findall(r"^  (\w+\.\S+)", table, re.MULTILINE) == first
    assert 0 < len(first) <= 12
    head, *lines = filter(None, re.sub(r",\n +", ", ", more).splitlines())
    named = [f"{group}.{n}" for group, *names in map(words, lines) for n in names]
    assert head == f"{len(named)} more: rotcal settings {method} GROUP"
    assert len(first) + len(named) <= 120
    assert lines[-1].startswith("  simulation ")
    others = {s["name"] for g in groups for s in g["settings"] if not (s["first"] or s["expert"])}
    for name in named:
        alike = fnmatch.filter(others, name)
        assert len(alike) > 1 if "*" in name else alike == [name]
        others.difference_update(alike)
    assert not others
    experts = sum(s["expert"] for group in groups for s in group["settings"])
    assert re.fullmatch(rf"(\d+) for experts: rotcal settings {method} --expert\n\n?", end)
    assert experts - 2 <= int(end.split()[0]) <= experts


def words(line):
    """Return the words of a line of names with commas."""
    return re.findall(r"[^\s,]+", line)


def test_those_for_experts_are_told_to_who_asks():
    told = run("capture").stdout
    assert "capture.window_samples" in told
    assert "capture.spike_floor_m" not in told
    assert told.endswith("\nand 7 for experts: rotcal settings capture --expert\n\n")
    whole = run("capture", "--expert").stdout
    usual, experts = whole.split("\nfor experts\n")
    assert "capture.window_samples" in usual
    assert "capture.window_samples" not in experts
    assert "capture.spike_floor_m" in experts
    assert len(re.findall(r"^  capture\.", experts, re.MULTILINE)) == 7
    assert run("capture", "--all").stdout == whole
    solver = run("plane_mirror", "solver").stdout
    assert "for experts: rotcal settings plane_mirror solver --expert\n" in solver
    (group,) = json.loads(run("capture", "--json").stdout)["groups"]
    marked = {s["name"]: s["expert"] for s in group["settings"]}
    assert marked["capture.spike_floor_m"] is True
    assert marked["capture.window_samples"] is False


def test_a_row_has_the_unit_the_default_and_what_must_be_given():
    lines = run("ball_plate", COLUMNS="99").stdout.splitlines()
    (radius,) = (line for line in lines if "plan.plate.circle_radius_m" in line)
    assert re.split(r" {2,}", radius.strip())[1:3] == ["m", "must be given"]
    (start,) = (line for line in lines if "plan.table_start_deg" in line)
    assert re.split(r" {2,}", start.strip())[1:3] == ["deg", "0"]


def test_without_a_method_each_of_them_begins_with_its_own():
    beside = entry_points(group="rotcal_ros.methods").names  # of packages that are installed
    assert run().stdout == "".join(run(name).stdout for name in sorted({*METHODS, *beside}))


def test_with_all_every_setting_and_the_goal_are_printed():
    lines = run("--all").stdout.splitlines()
    assert {f"plan of {method}" for method in METHODS} | {"capture"} <= {*lines}
    assert ("goal of a plan" in lines) == bool(names(GOALS))
    of_one = run("ball_plate", "--all").stdout.splitlines()
    assert {"plan of ball_plate", "simulation of ball_plate", "capture"} <= {*of_one}
    assert "goal of a plan" not in of_one


def test_groups_narrow_what_is_printed():
    groups = json.loads(run("ball_plate", "plan", "solver", "--json").stdout)["groups"]
    assert [(g["method"], g["group"]) for g in groups] == [
        ("ball_plate", "plan"), ("ball_plate", "solver"),
    ]  # fmt: skip
    assert run("capture").stdout.startswith("capture\n")
    assert run("ball_plate", "capture").stdout == run("capture").stdout


@pytest.mark.parametrize("arguments", [(), ("--all",)])
@pytest.mark.parametrize("columns", [60, 99])
def test_no_line_is_wider_than_the_terminal_and_nothing_is_cut(columns, arguments):
    narrow, wide = (run(*arguments, COLUMNS=str(width)).stdout for width in (columns, 1000))
    assert max(map(len, narrow.splitlines())) <= columns
    assert narrow.split() == wide.split()


def test_a_setting_that_must_be_given_says_so():
    assert "must be given" in run("ball_plate", "plan").stdout


def test_a_misspelt_name_gets_the_nearest_one():
    for arguments, hint in (
        (["ball_plat"], "no method, group or controller 'ball_plat'; did you mean 'ball_plate'?"),
        (
            ["ball_plat", "--json"],
            "no method, group or controller 'ball_plat'; did you mean 'ball_plate'?",
        ),
        (["captur"], "no method, group or controller 'captur'; did you mean 'capture'?"),
        (["ball_plate", "captur"], "no group 'captur'; did you mean 'capture'?"),
    ):
        ran = run(*arguments)
        assert ran.exit_code == 2
        assert hint in ran.stderr


def test_the_name_of_a_controller_stands_for_its_settings():
    ran = run("linuxcnc", "--json")
    (section,) = json.loads(ran.stdout)["groups"]
    found = {setting["name"]: setting for setting in section["settings"]}
    # joint N of [JOINT_N]: LinuxCNC 2.9 has 16 of them
    assert (found["joint"]["minimum"], found["joint"]["maximum"]) == (0, 15)
    assert "\n  machine_ini\n" in run("linuxcnc").stdout
