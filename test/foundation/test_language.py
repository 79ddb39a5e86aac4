"""Catalogues: every text that is used has a translation with the same places, and no other."""

import json
import re
import sys
import time
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.language import Phrase, codes, folders, language, listed, phrase

SCRIPTS = Path(__file__).parents[2] / "scripts"
OTHERS = codes()[1:]


def test_a_phrase_is_english_text_that_can_be_said_in_german():
    place = phrase("table position {0}, target {1}", 3, 30)
    whole = phrase("last: {0}", place)
    assert whole == "last: table position 3, target 30"
    assert json.loads(json.dumps(whole)) == str(whole)
    assert language("de").say(whole) == "zuletzt: Tischstellung 3, Zielpunkt 30"
    assert language("en").say(whole) == whole


def test_a_text_of_the_cell_stays_as_it_is_whatever_braces_it_has():
    german = language("de")
    assert german.say("ok") == "ok"  # data, no phrase
    assert german.say(phrase("last: {0}", "{0} {1} {x}")) == "zuletzt: {0} {1} {x}"
    assert german.say(phrase("{hostile}")) == "{hostile}"


def test_a_list_of_phrases_is_said_part_by_part():
    both = listed([phrase("drift"), phrase("tilt")], ", ")
    assert (both, language("de").say(both)) == ("drift, tilt", "Drift, Verkippung")
    assert type(listed([], ", ")) is Phrase
    assert listed([], ", ") == ""


@pytest.mark.parametrize(
    ("english", "german"),
    [
        ("no light is used", "es wird kein Licht verwendet"),
        ("the budget holds 3 um over the run",
         "das Messunsicherheitsbudget enthält 3 µm über die Dauer der Messung"),
        ("10 beam broken", "10 Strahl unterbrochen"),
        ("Error motion", "Bewegungsabweichung der Achse (Rundlauf)"),  # begins a caption
        ("ok (SIMULATED). Not tested for: drift, tilt",
         "in Ordnung (SIMULIERT). Nicht geprüft auf: Drift, Verkippung"),
        # a text in a place of another, and a place that ends at a mere blank
        ("2 of the 9 lengths of station 4 are off together, by about 5 um, and were left out: "
         "look for warm air, a person or an obstacle in the beams",
         "2 der 9 Längen bei Station 4 weichen gemeinsam ab, um etwa 5 µm, und wurden "
         "ausgeschlossen: mögliche Ursache: warme Luft, eine Person oder ein Hindernis im "
         "Strahlengang"),
        # a name of the cell in a place, with what looks like a place
        ("tracker station {0}, nest 2", "Lasertracker-Station {0}, Nest 2"),
    ],
)  # fmt: skip
def test_a_finished_text_is_understood(english, german):
    assert language("de").say(phrase(english)) == german
    assert language("en").say(phrase(english)) == english


def test_a_text_that_nobody_made_stays_english():
    german = language("de")
    for text in ("the moon is full", "the moon is full: no light is used", "", "; ", "tower: 5"):
        assert german(text) == text
    assert german.understood("the moon is full") is None


@pytest.mark.parametrize("code", OTHERS)
def test_no_entry_takes_the_text_of_another(code):
    spoken = language(code)
    numbers = range(99)
    entries = {e: g for e, g in spoken.texts.items() if len(e) > 20 and "{" in e}
    found = {english: spoken(english.format(*numbers)) for english in entries}
    assert {e: g for e, g in found.items() if g != entries[e].format(*numbers)} == {}


def test_a_hostile_text_takes_no_time():
    begun = time.process_time()
    for text in ("; of: " * 20_000, " " * 100_000, "that it looks as if " * 5_000, "1 " * 50_000):
        language("de")(text)
    assert time.process_time() - begun < 2.0


def test_an_unknown_language_is_named_with_those_that_there_are():
    with pytest.raises(ConfigurationError, match="'xx': choose en or de"):
        language("xx")


@pytest.fixture(scope="module")
def words():
    pytest.importorskip("babel")
    sys.path.append(str(SCRIPTS))
    import words

    return words


@pytest.mark.parametrize("code", OTHERS)
def test_a_catalogue_has_every_text_that_is_used_and_none_that_the_code_does_not_write(
    code, words
):
    known, wanted = language(code).texts, words.wanted()
    assert len(wanted) > 900
    for folder in words.folders():
        wanted |= words.wanted(folder)
    assert {text: where for text, where in wanted.items() if text not in known} == {}
    assert [text for text in known if text not in wanted] == []


@pytest.mark.parametrize("code", OTHERS)
def test_places_agree(code):
    def places(text):
        return set(re.findall(r"\{(\w*)\}", text))

    texts = language(code).texts
    assert {e: t for e, t in texts.items() if places(e) != places(t)} == {}


@pytest.mark.parametrize("code", OTHERS)
def test_the_file_is_read_as_gettext_reads_it(code):
    pofile = pytest.importorskip("babel.messages.pofile")
    found = {}
    for folder in folders():
        with (folder / f"{code}.po").open("rb") as file:
            messages = [message for message in pofile.read_po(file) if message.id]
        assert not any(message.fuzzy for message in messages)
        assert not found.keys() & {message.id for message in messages}
        found |= {message.id: message.string for message in messages}
    assert found == language(code).texts
