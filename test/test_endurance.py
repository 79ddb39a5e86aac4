"""What `make endurance` calls wrong: without nodes, on sessions as it notes them."""

import runpy
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def wrong():
    sys.path.append(str(SCRIPTS))  # it builds on soak.py, its neighbour
    return runpy.run_path(str(SCRIPTS / "endurance.py"))["wrong"]


SOUND = {
    "trouble": "none", "code": 0, "error": [], "resume_error": [], "verdict": "ok",
    "reasons": [], "difference": 1.2, "left_behind": 0, "in_history": True,
    "feed_code": 0,
}  # fmt: skip
NOT_FED = {"feed_code": 3}
REFUSED = {
    "trouble": "kill", "code": 2, "verdict": None, "error": ["rotcal: no node planner"], **NOT_FED,
}  # fmt: skip
SUSPECT = {"verdict": "suspect", **NOT_FED}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, ""),
        (REFUSED, ""),
        (SUSPECT | {"trouble": "stops", "code": 1, "reasons": ["lost"]}, ""),
        ({"code": -1}, "it did not end"),
        (REFUSED | {"error": ["KeyError: 'x'"]}, "an error of the program"),
        (REFUSED | {"error": []}, "it does not say why"),
        (SUSPECT | {"trouble": "clock"}, "suspect without a reason"),
        (SUSPECT | {"reasons": ["lost"]}, "a peaceful one is not ok"),
        ({"difference": 5.5}, "ok and another result"),
        ({"left_behind": 1}, "processes are left behind"),
        ({"in_history": False}, "not in the history"),
        (NOT_FED, "the feed and the verdict differ"),
        (
            SUSPECT | {"trouble": "stops", "reasons": ["lost"], "feed_code": 0},
            "the feed and the verdict differ",
        ),
    ],
)
def test_a_session_is_wrong_where_it_neither_ends_well_nor_says_why(wrong, change, says):
    assert wrong(SOUND | change) == says
