"""Reports of all methods in German: no English is left of what the program says."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from rotcal_ros.foundation.language import language, phrase, use_language
from rotcal_ros.foundation.plugins import METHODS, provider
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.page import ReportInput, render_report

ROOT = Path(__file__).parents[2]
RESULTS = [*ROOT.glob("test/golden/**/result.json"), *ROOT.glob("examples/data/result_*.json")]
ENGLISH = re.compile(
    r"\b(the|of|is|are|and|by|with|from|that|not|than|each|at|to|on|no|its|were|table|angle"
    r"|residuals?|measured|targets?|stations?|position)\b"
)
"""Words that no German text has."""
DETAILS = re.compile(r"<details><summary>[^<]*result\.json</summary>.*?</details>", re.DOTALL)
"""Names of entries of a file, which have no language."""
FOREIGN = ("pre", "code", "style")


class Texts(HTMLParser):
    """What a page says: its texts, names for screen readers, and the texts of its figures."""

    def __init__(self, page):
        super().__init__()
        self.texts, self._quiet, self._summary = [], 0, ""
        self.feed(re.sub(DETAILS, "", page))

    def handle_starttag(self, tag, attrs):
        self._quiet += tag in FOREIGN
        self.texts += [value for name, value in attrs if name == "aria-label"]

    def handle_endtag(self, tag):
        self._quiet -= tag in FOREIGN

    def handle_data(self, data):
        if not self._quiet and data.strip():
            self.texts.append(" ".join(data.split()))

    def handle_comment(self, data):
        self.texts.append(data.strip())


def german(result):
    title = find_method(result.method).title
    with use_language("de"):
        return render_report(ReportInput(result, title))


def english_left(page):
    return sorted({text for text in Texts(page).texts if ENGLISH.search(text)})


@pytest.mark.slow
@pytest.mark.parametrize("path", RESULTS, ids=lambda path: "/".join(path.parts[-3:-1]) + path.stem)
def test_nothing_is_english_in_the_report_of_a_sample(path):
    page = german(read_source(path).result)
    assert english_left(page) == []
    assert 'lang="en"' not in page
    assert len(Texts(page).texts) > 150


def phrases_in(code):
    """Return a code of a file with all that are its arguments."""
    inside = [each for each in code.get("arguments", ()) if isinstance(each, dict)]
    return [code["code"], *(text for each in inside for text in phrases_in(each))]


def test_all_words_of_all_codes_are_german():
    known = language("de").texts
    for path in RESULTS:
        for code in json.loads(path.read_text())["codes"]:
            unknown = [t for t in phrases_in(code) if t not in known and re.search("[a-z]{3}", t)]
            assert unknown == [], path


def test_captions_made_of_names_are_known_to_the_catalogue():
    for path in RESULTS:
        result = read_source(path).result
        for name in result.details.get("also", ()):
            caption = phrase(name.capitalize())
            assert name[:3].isupper() or language("de").has_translation(caption), name


def test_there_is_a_sample_of_every_method():
    methods = {json.loads(path.read_text())["method"] for path in RESULTS}
    assert methods == {name for name in method_names() if not provider(name, METHODS)}


@pytest.mark.usefixtures("without_figures")
def test_warnings_and_reasons_are_german_and_an_unknown_one_is_marked_as_english():
    known = read_source(ROOT / "examples/data/result_ball_plate.json").result
    held = phrase("the budget holds {0:g} um over the run", 3.0)
    warnings = (held, phrase("the moon is full"))
    page = german(replace(known, verdict="suspect", warnings=warnings))
    said = "das Messunsicherheitsbudget enthält 3 µm über die Dauer der Messung"
    assert f"die Bewertung lautet „zweifelhaft“: {said}; the moon is full" in page
    page = german(replace(known, warnings=warnings))
    assert f"<li>{said}</li>" in page
    assert '<li lang="en">the moon is full</li>' in page


@pytest.mark.usefixtures("without_figures")
def test_the_result_stays_as_it_is():
    result = read_source(ROOT / "examples/data/result_ball_plate.json").result
    before = result.to_json()
    german(result)
    assert result.to_json() == before
    assert language("de").texts is not None
