"""Catalogues: every text that is used has a translation with the same places, and no other."""

import json
import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.language import (
    Phrase,
    catalogue_folders,
    codes_of,
    join_texts,
    language,
    language_codes,
    phrase,
    with_codes,
)

SCRIPTS = Path(__file__).parents[2] / "scripts"
OTHERS = language_codes()[1:]


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
    both = join_texts([phrase("drift"), phrase("tilt")], ", ")
    assert (both, language("de").say(both)) == ("drift, tilt", "Drift, Verkippung")
    assert type(join_texts([], ", ")) is Phrase
    assert join_texts([], ", ") == ""


PLACE = phrase("table position {0}, target {1}", 3, 30)
MADE = [
    (phrase("no light is used"), "es wird kein Licht verwendet"),
    (phrase("the budget holds {0:g} um over the run", np.float64(3.0)),
     "das Messunsicherheitsbudget enthält 3 µm über die Dauer der Messung"),
    (phrase("Error motion"), "Bewegungsabweichung der Achse (Rundlauf)"),  # begins a caption
    (phrase("{0}: {1} messages cannot be decoded", PLACE, np.int64(2)),
     "Tischstellung 3, Zielpunkt 30: 2 Nachrichten sind nicht lesbar"),
    # a name of the cell in a place, with what looks like a place
    (phrase("tracker station {0}, nest {1}", "{0}", 2), "Lasertracker-Station {0}, Nest 2"),
    (phrase("p = {0:.2g}", float("inf")), "p = inf"),
    (phrase("ok"), "in Ordnung"),
]  # fmt: skip


@pytest.mark.parametrize(("made", "german"), MADE)
def test_a_phrase_stays_one_in_a_file_in_another_process_and_in_an_error(made, german):
    kept = json.loads(json.dumps({"texts": [made], "codes": codes_of([made])}, allow_nan=False))
    (read,) = with_codes(kept["texts"], kept["codes"])
    for again in (phrase(read), pickle.loads(pickle.dumps(made)), str(ValueError(made))):
        assert (again, type(again), again.parts) == (made.text, Phrase, made.parts)
        assert language("de").say(again) == german
        assert language("en").say(again) == made


def test_numbers_keep_their_digits_and_are_shown_as_their_places_say():
    made = phrase("{0:.1f} of {1}", 0.123456789, PLACE)
    assert made.coded["arguments"][0] == 0.123456789
    assert (made, made.shown) == (f"0.1 of {PLACE}", ["0.1", PLACE])


@pytest.mark.parametrize(
    "hostile",
    [
        {"text": "a 5", "code": "b {0}", "arguments": [5]},  # another text
        {"text": "a", "code": "a {0}", "arguments": []},
        {"text": "a x", "code": "a {0:g}", "arguments": ["x"]},
        {"text": "a 5", "code": "a {0:>999999999}", "arguments": [5]},
        {"text": "a 5", "code": "a {0.__class__}", "arguments": [5]},
        {"text": "a 5", "code": "a {0[0]}", "arguments": ["5"]},
        {"text": "a 5", "code": "a {0}", "arguments": [[5]]},
        {"text": "a 5", "code": "a {0}", "arguments": [{"number": "5"}]},
        {"text": 5, "code": "a", "arguments": []},
        {"text": "a"}, "a", 5, None,
    ],
)  # fmt: skip
def test_a_code_that_does_not_make_its_text_is_none(hostile):
    texts = ["a", "a 5", "a x"]
    assert with_codes(texts, [hostile]) == texts
    assert not any(type(text) is Phrase for text in with_codes(texts, [hostile]))
    assert with_codes(texts, hostile) == texts


def test_codes_in_codes_end_somewhere():
    deep = {"code": "a"}
    for _ in range(400):
        deep = {"text": "a", "code": "{0}", "arguments": [deep]}
    assert with_codes(["a"], [deep]) == ["a"]


def test_a_text_that_nobody_made_stays_english():
    german = language("de")
    for text in ("the moon is full", "the moon is full: no light is used", "", "; ", "tower: 5"):
        assert german.say(phrase(text)) == text
    assert not german.has_translation(phrase("the moon is full"))


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
    for folder in words.catalogue_folders():
        wanted |= words.wanted(folder)
    assert {text: where for text, where in wanted.items() if text not in known} == {}
    assert [text for text in known if text not in wanted] == []


@pytest.mark.parametrize("code", OTHERS)
def test_places_agree(code):
    def places(text):
        return set(re.findall(r"\{([^{}]*)\}", text))

    texts = language(code).texts
    assert {e: t for e, t in texts.items() if places(e) != places(t)} == {}


@pytest.mark.parametrize("code", OTHERS)
def test_the_file_is_read_as_gettext_reads_it(code):
    pofile = pytest.importorskip("babel.messages.pofile")
    found = {}
    for folder in catalogue_folders():
        with (folder / f"{code}.po").open("rb") as file:
            messages = [message for message in pofile.read_po(file) if message.id]
        assert not any(message.fuzzy for message in messages)
        assert not found.keys() & {message.id for message in messages}
        found |= {message.id: message.string for message in messages}
    assert found == language(code).texts
