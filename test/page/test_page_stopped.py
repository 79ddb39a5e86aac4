"""A calibration that was stopped: the page shows the whole command that goes on, to copy."""

import pytest

from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.page.state import PlannerStatus, current_activity

expect = pytest.importorskip("playwright.sync_api").expect

pytestmark = pytest.mark.slow

COMMAND = "rotcal run --resume '/data/my table'"
READY = NodeState(State.READY)
STOPPED = PlannerStatus(READY, ended=True, canceled=True, error="canceled", command=COMMAND)


def test_the_command_is_copied_by_keyboard(shown):
    page = shown({"now": current_activity(STOPPED)})
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    expect(page.locator("#command")).to_have_text(COMMAND)
    page.get_by_role("button", name="Copy").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#copied")).to_have_text("Copied")
    assert page.evaluate("navigator.clipboard.readText()") == COMMAND


def test_it_is_selected_where_the_browser_does_not_copy(shown):
    page = shown({"now": current_activity(STOPPED)})
    page.evaluate("""() => {
        Object.defineProperty(navigator, "clipboard", { value: undefined });
        document.execCommand = () => false;
    }""")
    page.get_by_role("button", name="Copy").click()
    expect(page.locator("#copied")).to_have_text("Press Ctrl+C")
    assert page.evaluate("getSelection().toString()") == COMMAND


def test_it_can_be_copied_after_the_cell_was_switched_off(shown):
    page = shown({"now": current_activity(STOPPED)})
    shown.board.show(ended=True)
    expect(page.locator("#lost")).to_contain_text("Switched off")
    expect(page.get_by_role("button", name="Copy")).to_be_enabled()


@pytest.mark.parametrize("size", [(360, 780), (1280, 900)])
def test_a_long_command_scrolls_in_its_own_box(shown, size):
    page = shown({"now": current_activity(STOPPED)}, size=size)
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


@pytest.mark.parametrize("error", ["", "node capture fell silent"])
def test_there_is_a_command_only_where_a_session_can_go_on(shown, error):
    ended = PlannerStatus(READY, ended=True, error=error, verdict="" if error else "ok")
    assert shown({"now": current_activity(ended)}).locator("#go_on").is_hidden()
