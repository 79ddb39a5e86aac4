"""The report in German: its frame and statements; numbers and names stay as they are."""

import re
from html.parser import HTMLParser

import pytest
from certified_samples import CIRCUMSTANCES, report, result

from rotcal_ros.foundation.language import language, use_language
from rotcal_ros.report.page import render_report

pytestmark = pytest.mark.usefixtures("without_figures")


class Frame(HTMLParser):
    """The texts of headings, heads of tables, captions and names of facts."""

    def __init__(self, page):
        super().__init__()
        self.texts, self._inside = [], None
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        scope = dict(attrs).get("scope")
        framed = tag in ("h1", "h2", "caption", "dt") or (tag == "th" and scope == "col")
        self._inside = tag if framed else self._inside

    def handle_endtag(self, tag):
        self._inside = None if tag == self._inside else self._inside

    def handle_data(self, data):
        if self._inside and re.search(r"[A-Za-z]{2}", data):
            self.texts.append(data)


def german():
    with use_language("de"):
        return render_report(report(title=TITLE))


TITLE = "Kalibrierbericht"


def test_the_frame_is_german():
    english, page = Frame(render_report(report())).texts, Frame(german()).texts
    assert len(page) == len(english) > 40
    same = {one for one, other in zip(english, page, strict=True) if one == other}
    translated = language("de").texts
    assert {text for text in same if translated.get(text, text) != text} == set()
    assert not same & {"Result", "Uncertainty budget", "Method", "Source"}


def test_the_statements_of_page_one_are_german_with_the_same_numbers():
    page, english = german(), render_report(report())
    assert '<html lang="de">' in page
    assert re.search(r"ECC liegt zwischen −[\d.]+ und [\d.]+ arcsec, Spannweite", page)
    assert "U ist die erweiterte Messunsicherheit" in page
    assert "JCGM 100:2008" in page
    numbers = [re.findall(r"<td>([−\d.]+)</td>", text) for text in (page, english)]
    assert numbers[0] == numbers[1] != []


def test_the_language_ends_with_its_page():
    german()
    assert '<html lang="en">' in render_report(report())


def test_what_a_person_wrote_is_not_translated():
    assert language("de").texts["Operator"] == "Bearbeiter"
    from dataclasses import replace

    named = replace(CIRCUMSTANCES.identity, operator="Operator")
    with use_language("de"):
        page = render_report(report(result(circumstances=replace(CIRCUMSTANCES, identity=named))))
    assert "<dt>Bearbeiter</dt><dd>Operator</dd>" in page
