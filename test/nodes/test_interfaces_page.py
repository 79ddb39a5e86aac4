"""docs/interfaces.md names every interface; their fields stand in docs/messages.md."""

import runpy
from pathlib import Path

import pytest

from rotcal_ros.methods import changed, prepare, read_configuration

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")


def test_every_interface_and_error_code_stands_there():
    names = {p.stem for p in (ROOT / "msg_defs").glob("*/*.*") if p.suffix in (".msg", ".srv")}
    assert {n for n in names if n not in PAGE} == set()
    action = (ROOT / "msg_defs" / "action" / "Calibrate.action").read_text()
    for line in action.splitlines():
        if line.startswith("uint16 ") and "=" in line:
            name, code = line.split()[1].split("=")
            assert f"| {code} `{name}` |" in PAGE


def test_the_page_of_messages_has_every_definition_whole():
    page = runpy.run_path(str(ROOT / "scripts" / "messages_page.py"))["page"]()
    definitions = [
        p for kind in ("msg", "srv", "action") for p in (ROOT / "msg_defs").glob(f"*/*.{kind}")
    ]
    assert len(definitions) > 25
    for path in definitions:
        assert f"### {path.stem}\n" in page
        assert path.read_text("utf-8").strip() in page


@pytest.mark.parametrize(
    ("file", "changes"),
    [
        ("plane_mirror_demo", ()),
        ("tracer_six_demo", ()),
        ("table_balls_demo", ("plan.chain=AC", "plan.tilts_deg=[-60.0, 0.0, 50.0]")),
        (
            "table_balls_demo",
            ("plan.measure=bar", "plan.bars_m=[0.3, 0.0, 0.2, 0.0, 0.3, 0.2, 0.1, 0.1, 0.4]"),
        ),
        ("angle_comparison_demo", ("plan.by_hand=true",)),
    ],
)
def test_what_a_robot_is_asked_to_move_stands_on_the_page_of_pauses(file, changes):
    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8")
    (row,) = [line for line in page.splitlines() if line.startswith("| `what`, `station` |")]
    made = prepare(changed(read_configuration(ROOT / "config" / f"{file}.yaml"), changes))
    moved = {pause.move.what for pause in made.plan.pauses if pause.move is not None}
    assert {what for what in moved if f"`{what}`" not in row} == set()
    assert moved
