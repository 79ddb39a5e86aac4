"""The page for keyboards and screen readers, in its states: what scrolls is reached and named."""

import pytest
from accessibility import assert_accessible, assert_reachable
from test_page_pause import SECOND, pause
from test_page_stopped import STOPPED
from test_page_words import DONE, MEASURING

from rotcal_ros.page.state import LogLine, current_activity

pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.slow

LOG = tuple(LogLine(1.7e9 + i, False, "capture", f"a warning, number {i}") for i in range(40))
STATES = {
    "measuring": MEASURING | {"log": LOG},
    "pause": pause(SECOND, 90.0),
    "done": DONE,
    "stopped": MEASURING | {"now": current_activity(STOPPED)},
}


@pytest.mark.parametrize("state", STATES)
def test_what_scrolls_is_reached_by_keyboard_and_has_a_name(shown, state):
    assert_reachable(shown(STATES[state], size=(360, 780)))


def test_a_long_list_scrolls_by_keyboard(shown):
    page = shown(STATES["measuring"])
    box = page.get_by_role("region", name="Warnings").and_(page.locator(".scroll"))
    box.focus()
    page.keyboard.press("End")
    page.wait_for_function("e => e.scrollTop > 0", arg=box.element_handle())


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("state", STATES)
def test_axe_finds_nothing(shown, state, scheme):
    assert_accessible(shown(STATES[state], scheme))
