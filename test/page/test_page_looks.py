"""The page can be read: contrast after WCAG 2.1 (criterion 1.4.3), names for all controls."""

import re

import pytest

from rotcal_ros.page.app import STATIC

CSS = (STATIC / "page.css").read_text()
TEXTS = (
    ("ink", "card"), ("ink", "ground"), ("soft", "card"), ("soft", "ground"), ("red", "card"),
    ("orange", "card"), ("on", "blue"), ("on", "red"), ("hatch_ink", "hatch"),
)  # fmt: skip
GRAPHICS = (("blue", "card"), ("green", "card"), ("orange", "ground"), ("soft", "card"))


def colours(dark):
    """Return the colours of a scheme by name, as the style sheet declares them."""
    blocks = re.findall(r":root \{([^}]*)\}", CSS)
    assert len(blocks) == 2
    return dict(re.findall(r"--(\w+): (#[0-9a-f]{6})\b", blocks[dark]))


def luminance(colour):
    """Return the relative luminance of WCAG 2.1."""
    channels = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_black_on_white_has_the_contrast_of_the_standard():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("dark", [False, True])
def test_texts_stand_out_by_four_and_a_half(dark):
    known = colours(dark)
    found = {pair: contrast(known[pair[0]], known[pair[1]]) for pair in TEXTS}
    assert {pair: c for pair, c in found.items() if c < 4.5} == {}
    assert contrast("#ffffff", "#7d1410") >= 4.5


@pytest.mark.parametrize("dark", [False, True])
def test_graphics_stand_out_by_three(dark):
    known = colours(dark)
    found = {pair: contrast(known[pair[0]], known[pair[1]]) for pair in GRAPHICS}
    assert {pair: c for pair, c in found.items() if c < 3.0} == {}


def test_every_section_has_a_name_and_the_instruction_is_read_out():
    text = (STATIC / "index.html").read_text()
    sections = re.findall(r"<section[^>]*>", text)
    assert all("aria-label" in section for section in sections)
    named = re.findall(r'aria-labelledby="(\w+)"', text)
    assert all(f'id="{name}"' in text for name in named)
    assert 'aria-live="assertive"' in text
    assert '<html lang="en">' in text
    assert re.findall(r'<label for="(\w+)"', text) == re.findall(r'<input id="(\w+)"', text)


def require_filled_places(page, scripts):
    """See that a page has every place that these scripts fill."""
    text = page.read_text()
    for path in scripts:
        names = re.findall(r'(?:by|text|draw|fill|getElementById)\("(\w+)"', path.read_text())
        assert [name for name in names if f'id="{name}"' not in text] == [], path


def test_every_place_that_the_scripts_fill_is_on_the_page():
    require_filled_places(STATIC / "index.html", STATIC.glob("[!u]*.js"))  # all but uPlot
