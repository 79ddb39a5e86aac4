"""The operator's page in a real browser: a calibration, a pause, a lost node, a reconnect."""

import re
from pathlib import Path

import pytest
from browser import launched
from live_cell import SUITE, LiveCell
from page_viewer import address
from test_bridge import SECRET, Bench, table

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods.configuration import changed, read_configuration

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytest.importorskip("starlette")
sync_api = pytest.importorskip("playwright.sync_api")
expect = sync_api.expect
pytestmark = pytest.mark.ros

TIMEOUT_MS = 60_000
CONFIG = Path(__file__).parents[2] / "config"
SLOW = "simulation.time_scale=4.0"
SIX = ("plan.table_positions=8", "plan.box_points=[2, 2, 2]", "planner.preflight_timeout_s=20.0")


@pytest.fixture
def browser():
    expect.set_options(timeout=load_scaled_timeout(TIMEOUT_MS))
    with sync_api.sync_playwright() as playwright:
        opened = launched(playwright)
        yield opened
        opened.close()


@pytest.fixture
def opened(browser):
    """Return a function that opens a page, and fails for any request to elsewhere."""
    strange, errors = [], []

    def open_(url, **options):
        page = browser.new_page(**options)
        page.on("request", lambda r: None if r.url.startswith(url) else strange.append(r.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(url)
        return page

    yield open_
    assert (strange, errors) == ([], [])


@pytest.fixture
def six(cell, tmp_path):
    """Return a live cell whose plan asks for a person three times."""
    made = LiveCell(tmp_path, changed(read_configuration(CONFIG / "tracer_six_demo.yaml"), SIX))
    yield made
    made.processes.end()


def overflow(page):
    return page.evaluate("document.documentElement.scrollWidth - innerWidth")


@pytest.mark.long  # test_page_live.py has it without the browser
def test_a_whole_calibration_with_its_pauses(six, opened):
    six.start(*SUITE, "simulated_cell", "operator_page")
    url = address(six)
    page = opened(url, viewport={"width": 1280, "height": 900})
    expect(page.locator("#reality")).to_have_text("SIMULATED")
    client = six.client()
    button = page.get_by_role("button", name="Continue")
    for place in range(3):
        expect(page.locator("#headline")).to_contain_text(f"Fix the tracer at place {place + 1}")
        expect(page.locator("#now")).to_have_attribute("data-kind", "person")
        assert page.title().startswith("▶")
        if place == 1:
            button.focus()
            page.keyboard.press("Enter")
        else:
            button.click()
        client.wait_for("feedback", where=lambda event: "table position" in event["activity"])
    narrow = opened(url, viewport={"width": 360, "height": 740})  # comes late
    expect(narrow.locator("#total")).to_contain_text("of 192")
    assert client.result()["error_code"] == 0
    for viewer in (page, narrow):
        expect(viewer.locator("#headline")).to_contain_text("Finished, measurement")
        expect(viewer.locator("#curve canvas")).to_be_visible()
        expect(viewer.get_by_role("button", name="EXC")).to_be_visible()
        assert overflow(viewer) <= 0
    page.get_by_role("button", name="EXC").click()
    expect(page.locator("#curve")).to_have_attribute("aria-label", re.compile("^EXC at 8 angles"))
    six.processes.end()
    expect(page.locator("#lost")).to_contain_text("Switched off at")


@pytest.mark.long
def test_stop_asks_first_and_works_without_a_mouse(cell, opened):
    live = cell(SLOW)
    live.start(*SUITE, "simulated_cell", "operator_page")
    page = opened(address(live))
    client = live.client()
    expect(page.locator("#headline")).to_have_text("Measuring")
    stop = page.get_by_role("button", name="Stop …")
    stop.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Enter")  # the first button keeps measuring
    expect(page.get_by_role("dialog")).to_be_hidden()
    expect(page.locator("#headline")).to_have_text("Measuring")
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert client.result()["canceled"] is True
    expect(page.locator("#headline")).to_have_text("Stopped")
    expect(page.locator("#answer")).to_have_text("")  # no "Stopping" below it


@pytest.mark.slow
def test_a_killed_node_is_told_large(cell, opened):
    live = cell(SLOW)
    live.start(*SUITE, "simulated_cell", "operator_page")
    page = opened(address(live))
    live.client()
    expect(page.locator("#step")).to_have_text(re.compile("^[3-9]"))
    live.kill("capture")
    expect(page.locator("#headline")).to_have_text("The calibration ended without a result")
    expect(page.locator("#detail")).to_contain_text("Node capture is lost")
    expect(page.locator('#nodes li:has(.name:text-is("capture"))')).to_contain_text("silent")
    expect(page.locator("#now")).to_have_attribute("data-kind", "failed")


@pytest.mark.slow
def test_a_page_without_contact_looks_dead_and_comes_back(cell, opened):
    live = cell()
    live.start("planner", "operator_page")
    url = address(live)
    page = opened(url)
    expect(page.locator("#headline")).to_have_text("Ready")
    live.kill("operator_page")
    expect(page.locator("#lost")).to_contain_text("Connection lost at")
    expect(page.locator("body")).to_have_class("dead")
    assert float(page.locator("main").evaluate("e => getComputedStyle(e).opacity")) < 0.5
    live.file.write_text(
        f"/**:\n  ros__parameters:\n    page: {{port: {url.rpartition(':')[2]}}}\n"
    )
    live.start("operator_page", name="again")
    expect(page.locator("#lost")).to_be_hidden()
    expect(page.locator("body")).to_have_class("live")


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def test_a_table_is_looked_at_and_confirmed_by_its_hash(bench, opened):
    bench.publish(table())
    bench.start()
    bench.live.start("operator_page")
    page = opened(address(bench.live))
    expect(page.locator("#offer_chart canvas")).to_be_visible()
    shown = page.locator("#offer_facts .hash").inner_text()
    for secret, button in (("", "Not now"), ("a guess", "Feed to the controller")):
        page.get_by_role("button", name="Confirm the table …").click()
        expect(page.locator("#apply_hash")).to_have_text(shown)
        page.get_by_label("The bridge’s secret").fill(secret)
        page.get_by_role("button", name=button).click()
        expect(page.get_by_role("dialog")).to_be_hidden()
    expect(page.locator("#answer")).to_contain_text("does not carry the secret")
    assert bench.files() == set()
    page.get_by_role("button", name="Confirm the table …").click()
    page.get_by_label("The bridge’s secret").fill(SECRET)
    page.get_by_role("button", name="Feed to the controller").click()
    expect(page.locator("#answer")).to_contain_text("verified by reading it back")
    expect(page.locator("#now")).not_to_have_attribute("data-kind", "confirm")
    assert "c_linuxcnc.comp" in bench.files()
    assert page.locator("#secret").input_value() == ""


def test_words_of_the_cell_are_no_markup(cell, opened):
    live = cell("cell.joint='<img src=x onerror=document.title=1>'")
    live.start("planner", "operator_page")
    page = opened(address(live))
    live.client(configuration=None)
    expect(page.locator("#headline")).not_to_be_empty()
    assert page.locator("main img").count() == 0
