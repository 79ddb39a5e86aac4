"""The report can be read by everyone: names, headers, contrast after WCAG 2.1, light and dark."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
from certified_samples import report, result

from rotcal_ros.foundation.results import RepeatedRuns
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.figures import style
from rotcal_ros.report.page import render_report
from rotcal_ros.report.template import PROPERTIES


class Elements(HTMLParser):
    """All elements of a page with their attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def named(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


@pytest.fixture(scope="module")
def page():
    steps = np.array([-1.0, 0.0, 1.0]) * 0.1 * ARCSEC
    forward = np.array([0.0, 2.0, 1.0])[:, None] * ARCSEC + steps
    runs = RepeatedRuns(np.array([0.0, 1.0, 2.0]), forward, forward - ARCSEC)
    return render_report(report(result(runs=runs)))


@pytest.mark.slow
def test_every_figure_has_a_name_and_none_twice_the_same(page):
    figures = Elements(page).named("svg")
    names = [figure["aria-label"] for figure in figures]
    assert len(figures) >= 7
    assert all(figure["role"] == "img" for figure in figures)
    assert len(set(names)) == len(names)


def test_every_header_of_a_table_has_a_scope_and_every_table_a_caption(page):
    elements = Elements(page)
    assert all(th["scope"] in ("col", "row") for th in elements.named("th"))
    assert len(elements.named("caption")) == len(elements.named("table")) >= 7


def test_the_page_says_its_language_and_its_headings_go_down_by_one(page):
    elements = Elements(page)
    assert elements.named("html")[0]["lang"] == "en"
    levels = [int(tag[1]) for tag, _ in elements.found if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert max(np.diff(levels)) <= 1


def luminance(colour):
    """Return the relative luminance of #rrggbb, WCAG 2.1."""
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def colours(page, scheme):
    """Return the custom properties of a scheme, those of figures included."""
    light, dark = (
        dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))
        for block in re.findall(r":root \{(.*?)\}", page, flags=re.DOTALL)[:2]
    )
    figures = {f"figure-{name}": colour for colour, name in PROPERTIES.items()}
    return figures | light | (dark if scheme == "dark" else {})


def test_black_on_white_has_the_contrast_of_the_standard():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_a_contrast_of_4_5_and_lines_of_3(page, scheme):
    known = colours(page, scheme)
    for ink in ("ink", "soft", "suspect", "failed", "simulated"):
        assert contrast(known[ink], known["paper"]) >= 4.5, ink
    assert contrast(known["soft"], known["wash"]) >= 4.5
    for verdict in ("ok", "partly", "suspect", "failed"):
        assert contrast(known["pill"], known[verdict]) >= 4.5, verdict
    for name in ("blue", "orange", "green", "red", "grey"):
        assert contrast(known[f"figure-{name}"], known["figure-paper"]) >= 3.0, name
    assert contrast(known["figure-ink"], known["figure-paper"]) >= 4.5


def test_the_dark_knows_every_colour_of_the_figures(page):
    light, dark = colours(page, "light"), colours(page, "dark")
    assert all(light[f"figure-{n}"] != dark[f"figure-{n}"] for n in PROPERTIES.values())
    assert f"var(--figure-blue, {style.BLUE})" in page


@style.house_style
def drawing(name):
    (ax,) = style.grid()
    ax.plot([0.0, 360.0], [0.0, 1.0], label=name)
    style.angle_axis(ax, np.array([0.0, 360.0]))
    return style.svg(ax)


def test_a_dollar_in_a_name_is_a_dollar():
    assert "<svg" in drawing("cost $5 and $unfinished_{")


def test_equal_names_share_one_entry_of_the_one_legend():
    (ax, other) = style.grid(2)
    for panel in (ax, other):
        panel.plot([0.0, 1.0], [0.0, 1.0], label="curve")
    style.svg(ax)
    (legend,) = ax.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["curve"]
    assert other.get_legend() is None


@pytest.mark.parametrize(
    ("first", "last", "step"), [(0.0, 360.0, 30.0), (-145.0, 155.0, 30.0), (0.0, 90.0, 15.0),
                                (0.0, 55.0, 5.0), (0.0, 330.0, 30.0)]
)  # fmt: skip
def test_angles_are_ticked_where_people_look_for_them(first, last, step):
    (ax,) = style.grid()
    ax.plot([first, last], [0.0, 1.0])
    style.angle_axis(ax, np.array([first, last]))
    np.testing.assert_allclose(np.diff(ax.get_xticks()), step)
    np.testing.assert_allclose(np.mod(ax.get_xticks(), step), 0.0, atol=1e-9)


def test_narrow_panels_have_fewer_ticks():
    left, _ = style.grid(1, 2)
    left.plot([0.0, 360.0], [0.0, 1.0])
    style.angle_axis(left, np.array([0.0, 360.0]))
    np.testing.assert_allclose(np.diff(left.get_xticks()), 90.0)
