"""What a browser shows of a state: one number for one thing, one U, and two marks at the end."""

import re

import pytest

from rotcal_ros.evaluation.marks import Mark
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import place_in_words
from rotcal_ros.page.state import (
    Curve,
    Deviations,
    OrderedStep,
    PageMark,
    PlannerStatus,
    PlanView,
    RejectedAttempt,
    ShownUncertainty,
    StepProgress,
    current_activity,
)

pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.slow

HERE = NodeState(State.CALIBRATING)
PLACE = place_in_words(5, 34)
# What a policy reports in its 67th step of 105 expected ones; the plan holds 2344 pairs.
MEASURING = {
    "now": current_activity(
        PlannerStatus(HERE, calibrating=True, doing=Why.MEASURING, activity=PLACE)
    ),
    "steps": StepProgress(step=66, total=105, accepted=64, rejected=6, left=39, end_s=None),
    "view": PlanView((0.0, 30.0, 60.0), ((0.5, 0.0), (0.0, 0.5)), ((0.1, 0.1),)),
    "pointing": OrderedStep(PLACE, 150.0, (0.5, 0.0), (0.1, 0.1), (0.0, 30.0)),
    "rejections": (RejectedAttempt(1.7e9, place_in_words(2, 21, 1), "beam broken"),),
    "standing": ShownUncertainty(
        largest_arcsec=0.96, rms_arcsec=0.6, goal_arcsec=0.79, course=((10.0, 1.5), (64.0, 0.96))
    ),
}
CURVE = Curve("ECC", "arcsec", (0.0, -3.0), (0.0, 0.96))
MARKS = (
    PageMark.of(Mark("measurement", "ok", phrase("ok"), phrase("Not tested for: {0}", "drift"))),
    PageMark(
        "tolerance",
        "beyond",
        phrase("{0}: {1} {2}", phrase("tolerance"), phrase("beyond"), "±2 arcsec (ECC)"),
    ),
)
DONE = MEASURING | {
    "now": current_activity(PlannerStatus(HERE, ended=True, verdict="ok")),
    "deviations": Deviations((0.0, 180.0), (CURVE,), 104, True, MARKS, ()),
}


def test_there_is_one_count_of_steps_and_places_have_no_numbers_that_look_like_one(shown):
    page = shown(MEASURING)
    assert page.locator("#step").inner_text() == "66"
    assert page.locator("#total").inner_text() == "of 105"
    assert (
        page.locator("#rejected_last").inner_text()
        == "last: table position 2, target 21 (attempt 2)"
    )
    assert "Table position 5, target 34." in page.locator("#view_words").inner_text()
    assert "Table position 2, target 21 (attempt 2): beam broken" in page.inner_text("#rejections")
    assert re.findall(r"(?i)\bstep \d+", page.inner_text("main")) == []


def test_u_is_the_largest_of_the_curve_everywhere_and_the_goals_figure_has_its_own_name(shown):
    page = shown(DONE)
    assert page.locator("#uncertainty").inner_text() == "0.96″"
    assert page.locator("#goal").inner_text() == (
        "largest of the curve; goal: rms of U 0.79″, now 0.60″, reached"
    )
    text = page.inner_text("main")
    assert set(re.findall(r"(?<!rms of )U [^.]*?(\d\.\d+)", text)) <= {"0.96"}
    assert "at most 0.96" in page.inner_text("#curve_words")
    assert "0.60″" in page.inner_text("#standing_words")


def test_before_all_stations_are_placed_the_goals_figure_is_not_known(shown):
    unknown = ShownUncertainty(largest_arcsec=None, rms_arcsec=None, goal_arcsec=0.79)
    page = shown(MEASURING | {"standing": unknown})
    assert page.locator("#uncertainty").inner_text() == "–"
    assert page.inner_text("#goal").endswith("goal: rms of U 0.79″, now unknown")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_both_marks_stand_under_the_headline_each_in_its_colour(shown, scheme):
    page = shown(DONE, scheme)
    found = page.locator("#marks .mark").all()
    assert [mark.inner_text() for mark in found] == [
        "Measurement: ok", "Tolerance: beyond ±2 arcsec (ECC)"
    ]  # fmt: skip
    style = "e => getComputedStyle(e).backgroundColor"
    ok, beyond = (mark.evaluate(style) for mark in found)
    known = {"light": "rgb(171, 31, 23)", "dark": "rgb(255, 154, 144)"}
    assert beyond == known[scheme]
    assert ok != beyond
    assert page.locator("#marks .remark").inner_text() == "Not tested for: drift"


def test_there_are_no_marks_before_the_end(shown):
    page = shown(MEASURING | {"deviations": Deviations((0.0, 180.0), (CURVE,), 64, False, (), ())})
    assert page.locator("#marks").is_hidden()
