"""The page in German: by the browser's language or by choice, with no English word left."""

import re

import pytest
from test_page_accessible import STATES

from rotcal_ros.foundation.language import language
from rotcal_ros.foundation.node_state import NO_PLAN, NodeState, State, Why
from rotcal_ros.page.state import (
    RecorderState,
    ShownNode,
    ShownOffer,
    Temperature,
    TopicState,
)

expect = pytest.importorskip("playwright.sync_api").expect

pytestmark = pytest.mark.slow

NODES = (
    ShownNode("capture", NodeState.of(State.WORKING, Why.CAPTURING, "7f3a").describe(), 0),
    ShownNode("solver", NO_PLAN.describe(), 1),
)
REST = {
    "nodes": NODES,
    "streams": (TopicState("tracer_length", 1000.0, None), TopicState("probe", 0.0, 3.2)),
    "recording": RecorderState("/messung/b.mcap", 12, 0, (), 20.5),
    "temperatures": (Temperature("t1", 20.12, 20.0, 20.25, 0.1, ((1.7e9, 20.0), (1.7e9, 20.1))),),
    "offer": ShownOffer("abc", "def", "", "", "", "", "", applied=True),
}
NAMES = {"live", "drift", "redundancy", "laser", "start", "any", "name", "in", "ready", "transit"}
"""Words that German has too, or that are names."""


def english_words():
    """Return words that occur in English texts of the catalogue, and in no German one."""
    texts = language("de").texts
    english, german = (
        set(re.findall(r"[a-z]{3,}", " ".join(side).lower())) for side in (texts, texts.values())
    )
    return english - german - NAMES


FREE = "#instruction_words, #command, #log, #rejections, .name, option"
"""Places with what the cell says in words of its own."""


def spoken(page):
    """Return all that is seen or read out, without names of the cell and folded instructions."""
    return page.evaluate(
        """(FREE) => {
        const named = [...document.querySelectorAll("[aria-label]")].map((e) => e.ariaLabel);
        const text = [...document.querySelectorAll(FREE)]
          .reduce((all, e) => { e.remove(); return all; }, document.body);
        return [text.innerText, ...named].join("\\n");
    }""",
        FREE,
    )


@pytest.mark.parametrize("state", STATES)
def test_no_english_word_of_the_catalogue_is_left(shown, state):
    sections = REST | STATES[state]
    page = shown(sections, locale="de-DE")
    expect(page.locator("html")).to_have_attribute("lang", "de")
    words = set(re.findall(r"[a-zäöüß]{3,}", spoken(page).lower()))
    assert len(words) > 40
    assert words & english_words() == set()


def test_numbers_have_a_comma(shown):
    page = shown(REST | STATES["measuring"], locale="de-AT")
    expect(page.locator("#uncertainty")).to_have_text("0,96″")
    expect(page.locator("#temperatures")).to_contain_text("20,12 °C")


def test_a_pause_reads_as_a_person_would_say_it(shown):
    page = shown(STATES["pause"], locale="de-DE")
    expect(page.locator("#headline")).to_have_text(
        "Lasertracer auf dem Tisch befestigen: Standort 2 von 3"
    )
    expect(page.locator("#task_facts")).to_contain_text(
        "120,0°, gegen den Uhrzeigersinn von seiner 0°-Marke"
    )
    expect(page.get_by_role("button", name="Weiter")).to_be_visible()


def test_the_language_is_chosen_and_remembered(shown):
    page = shown(STATES["measuring"], locale="en-GB")
    expect(page.locator("#headline")).to_have_text("Measuring")
    page.get_by_label("Language").select_option("de")
    expect(page.locator("#headline")).to_have_text("Messung läuft")
    page.reload()
    expect(page.locator("#headline")).to_have_text("Messung läuft")


def test_another_language_of_the_browser_is_english(shown):
    page = shown(STATES["measuring"], locale="fr-FR")
    expect(page.locator("#headline")).to_have_text("Measuring")
