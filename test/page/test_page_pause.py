"""A pause on the page: one headline, a picture of the place with its measures, then Continue."""

import math
import re

import pytest

from rotcal_ros.foundation.node_state import NodeState, Reason, State, Why
from rotcal_ros.foundation.observations import place_in_words
from rotcal_ros.page.state import (
    OperatorTask,
    OrderedStep,
    PlannerStatus,
    PlanView,
    current_activity,
)

expect = pytest.importorskip("playwright.sync_api").expect

pytestmark = pytest.mark.slow

SECOND = OperatorTask(
    "tracer", 2, 3, 1, (-0.075, 0.12990381, 0.12), rides=True
)  # 150 mm at 120 deg
TRACKER = OperatorTask("tracker", 1, 2, 0, (0.0, 2.0, 0.3))
VIEW = PlanView(tuple(45.0 * i for i in range(8)), ((0.3, 0.3), (-0.3, 0.3)), ((0.15, 0.0),))
BEAM = OrderedStep(place_in_words(5, 34), 90.0, (0.3, 0.3), (0.15, 0.0), (0.0, 90.0))


def pause(task, table_deg, instruction="fix the tracer; it must not move"):
    heard = PlannerStatus(
        NodeState(State.CALIBRATING), calibrating=True, doing=Why.WORK, instruction=instruction,
        task=task,
    )  # fmt: skip
    sections = {"now": current_activity(heard), "task": task, "table_deg": table_deg}
    return sections | {"view": VIEW, "pointing": BEAM}


def facts(page):
    names, values = (page.locator(f"#task_facts {tag}").all_inner_texts() for tag in ("dt", "dd"))
    return dict(zip(names, values, strict=True))


def drawn_at(page, where):
    """Return direction (deg) and distance of the place in a drawing, seen from its centre."""
    spot = page.locator(f"{where} circle.place")
    x, y = (float(spot.get_attribute(name)) for name in ("cx", "cy"))
    return math.degrees(math.atan2(-y, x)) % 360.0, math.hypot(x, y)


def test_one_headline_counts_from_one_and_the_measures_stand_below(shown):
    page = shown(pause(SECOND, 90.0))
    expect(page.locator("#headline")).to_have_text("Fix the tracer at place 2 of 3 on the table")
    assert facts(page) == {
        "Angle on the table": "120.0°, counter-clockwise from its 0°",
        "Distance from the axis": "150 mm",
        "Height above the table": "120 mm",
        "The table stands at": "90.0°",
        "Number in the data": "1",
    }
    assert page.locator("#task_view text").all_text_contents() == ["0°", "120.0°", "150 mm"]


@pytest.mark.parametrize("where", ["#task_view", "#view"])
def test_a_place_on_the_table_is_drawn_where_it_stands_now_and_the_old_beam_is_gone(shown, where):
    page = shown(pause(SECOND, 90.0))
    direction, distance = drawn_at(page, where)
    assert (direction, distance) == pytest.approx((210.0, 0.15), abs=1e-6)
    assert page.locator(f"{where} .beam").count() == 0
    shown.board.show(table_deg=100.0)  # somebody turns it by hand
    expect(page.locator("#task_facts")).to_contain_text("100.0°")
    assert drawn_at(page, where)[0] == pytest.approx(220.0, abs=1e-6)


def test_a_tracker_beside_the_table_does_not_turn_with_it(shown):
    page = shown(pause(TRACKER, 30.0))
    expect(page.locator("#headline")).to_have_text("Put the tracker at place 1 of 2")
    assert drawn_at(page, "#task_view") == pytest.approx((90.0, 2.0), abs=1e-6)
    assert facts(page)["Direction from the axis"] == "90.0°, counter-clockwise from the x axis"
    assert facts(page)["The table stands at"] == "30.0°"


def test_the_beam_is_drawn_while_it_measures(shown):
    page = shown(pause(SECOND, 90.0))
    shown.board.show(
        now=current_activity(PlannerStatus(NodeState(State.CALIBRATING), calibrating=True)),
        task=None,
    )
    expect(page.locator("#view .beam")).to_have_count(1)
    assert page.locator("#task_view").is_hidden()


def test_work_that_was_not_done_well_says_what_is_wrong(shown):
    wrong = "not right yet: the tracer is 3 mm off; correct it (fix the tracer)"
    again = OperatorTask(SECOND.what, 2, 3, 1, SECOND.at, rides=True, again=True)
    page = shown(pause(again, 90.0, wrong))
    expect(page.locator("#headline")).to_have_text("Not in place yet: tracer at place 2 of 3")
    expect(page.locator("#detail")).to_have_text(re.compile("the tracer is 3 mm off"))


def test_after_continue_the_keyboard_is_at_the_headline(shown):
    page = shown(pause(SECOND, 90.0))
    page.get_by_role("button", name="Continue").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#headline")).to_be_focused()
    assert shown.asked == [("resume", "fix the tracer; it must not move")]


@pytest.mark.parametrize("size", [(360, 780), (1280, 900), (3840, 2160)])
@pytest.mark.parametrize("task", [SECOND, TRACKER])
def test_the_picture_fits_and_stands_above_the_fold(shown, size, task):
    page = shown(pause(task, 90.0), size=size)
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    box = page.locator("#task_view").bounding_box()
    assert box["width"] >= 200
    assert box["y"] + box["height"] <= size[1]


def test_a_stop_says_what_happened_from_its_reason():
    stopped = NodeState(State.CALIBRATING, (Reason.of(Why.STOPPED, "door is open"),))
    heard = PlannerStatus(
        stopped, calibrating=True, doing=Why.STOPPED, instruction="emergency stop"
    )
    found = current_activity(heard)
    assert (found.kind, found.headline) == ("emergency", "Emergency stop: door is open.")
    assert found.detail.endswith("Release the stop, then press Continue.")
