"""Sound and notification for a pause or an end: off until somebody asks, then remembered."""

import pytest
from test_page_pause import SECOND, pause
from test_page_stopped import STOPPED
from test_page_words import DONE, MEASURING

from rotcal_ros.page.state import current_activity

expect = pytest.importorskip("playwright.sync_api").expect

pytestmark = pytest.mark.slow

LISTEN = """
window.heard = []; window.notes = []; window.asked = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) {
  window.heard.push(this.frequency.value);
  return start.apply(this, when);
};
window.Notification = class {
  static permission = "PERMISSION";
  static requestPermission() { window.asked += 1; return Promise.resolve("PERMISSION"); }
  constructor(title, { body }) { window.notes.push([title, body]); }
};
"""
PAUSE = pause(SECOND, 90.0)


@pytest.fixture
def listening(shown):
    """Return what opens a page, and asks it for sounds, in a browser with a permission."""

    def open_page(permission="granted", ask=True):
        page = shown(MEASURING)
        page.context.add_init_script(LISTEN.replace("PERMISSION", permission))
        page.reload()
        page.wait_for_selector("body.live")
        if ask:
            page.get_by_label("Sound and notification").check()
            page.evaluate("window.heard.length = 0")
        return page

    return open_page


def told(page):
    return page.evaluate("[window.heard, window.notes]")


def test_nothing_is_heard_or_asked_unless_somebody_wants_it(listening, shown):
    page = listening(ask=False)
    assert not page.get_by_label("Sound and notification").is_checked()
    shown.board.show(**PAUSE)
    expect(page.locator("#now")).to_have_attribute("data-kind", "person")
    assert (told(page), page.evaluate("window.asked")) == ([[], []], 0)


def test_a_pause_is_heard_and_notified_once(listening, shown):
    page = listening()
    shown.board.show(**PAUSE)
    expect(page.locator("#now")).to_have_attribute("data-kind", "person")
    shown.board.show(table_deg=91.0)
    expect(page.locator("#task_facts")).to_contain_text("91.0°")
    heard, notes = told(page)
    assert heard == [660, 880]
    assert notes == [
        ["Fix the tracer at place 2 of 3 on the table", "Press Continue when it is done."]
    ]


@pytest.mark.parametrize("permission", ["denied", "default"])
@pytest.mark.parametrize("end", [DONE, {"now": current_activity(STOPPED)}])
def test_without_permission_an_end_is_heard_alone(listening, shown, permission, end):
    page = listening(permission)
    shown.board.show(**end)
    expect(page.locator("#headline")).to_have_text(end["now"].headline)
    assert told(page) == [[660, 660], []]


def test_the_choice_is_remembered(listening):
    page = listening()
    page.reload()
    page.wait_for_selector("body.live")
    expect(page.get_by_label("Sound and notification")).to_be_checked()
    page.get_by_label("Sound and notification").uncheck()
    page.reload()
    page.wait_for_selector("body.live")
    expect(page.get_by_label("Sound and notification")).not_to_be_checked()
