"""Catalogues: every text that is used has a translation with the same places, and no other."""

import json
import re
import sys
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.language import FOLDER, Phrase, codes, language, listed, phrase

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


def test_an_unknown_language_is_named_with_those_that_there_are():
    with pytest.raises(ConfigurationError, match="'xx': choose en or de"):
        language("xx")


@pytest.fixture(scope="module")
def used():
    pytest.importorskip("babel")
    sys.path.append(str(SCRIPTS))
    import words

    return words.used()


@pytest.mark.parametrize("code", OTHERS)
def test_a_catalogue_has_every_text_that_is_used_and_no_other(code, used):
    known = language(code).texts
    assert len(used) > 300
    assert {text: where for text, where in used.items() if text not in known} == {}
    assert [text for text in known if text not in used] == []


@pytest.mark.parametrize("code", OTHERS)
def test_places_agree(code):
    def places(text):
        return set(re.findall(r"\{(\w*)\}", text))

    texts = language(code).texts
    assert {e: t for e, t in texts.items() if places(e) != places(t)} == {}


@pytest.mark.parametrize("code", OTHERS)
def test_the_file_is_read_as_gettext_reads_it(code):
    pofile = pytest.importorskip("babel.messages.pofile")
    with (FOLDER / f"{code}.po").open("rb") as file:
        catalogue = pofile.read_po(file)
    assert {m.id: m.string for m in catalogue if m.id} == language(code).texts
    assert not any(message.fuzzy for message in catalogue if message.id)
