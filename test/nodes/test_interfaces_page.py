"""docs/interfaces.md names everything that is there, with its default."""

from pathlib import Path

import pytest

from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.planning.planner_settings import PlannerSettings
from rotcal_ros.settings import declarations

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("group", "cls"),
    [("cell", CellSettings), ("planner", PlannerSettings), ("recorder", RecorderSettings)],
)
def test_every_parameter_stands_there_with_default_and_meaning(group, cls):
    for declared in declarations(cls):
        shown = declared.default if declared.default != "" else '""'
        assert f"| `{group}.{declared.name}` | {shown} |" in PAGE
        assert declared.info.description in PAGE


def test_every_interface_and_error_code_stands_there():
    names = {p.stem for p in (ROOT / "msg_defs").glob("*/*.*") if p.suffix in (".msg", ".srv")}
    assert {n for n in names if n not in PAGE} == set()
    action = (ROOT / "msg_defs" / "action" / "Calibrate.action").read_text()
    for line in action.splitlines():
        if line.startswith("uint16 ") and "=" in line:
            name, code = line.split()[1].split("=")
            assert f"| {code} `{name}` |" in PAGE
