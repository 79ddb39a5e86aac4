"""The report in Debian's Chromium: no overflow, dark figures, and pages that print."""

import re
from dataclasses import replace
from shutil import which
from subprocess import run

import pytest
from accessibility import assert_accessible, assert_reachable
from browser import launched
from certified_samples import CIRCUMSTANCES, report, result

from rotcal_ros.report.page import render_report

playwright = pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as running:
        browser = launched(running)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    shown = result(circumstances=replace(CIRCUMSTANCES, simulated=True))
    path.write_text(render_report(report(shown)), encoding="utf-8")
    return path.as_uri()


@pytest.mark.parametrize("width", [400, 1280])
def test_nothing_hangs_over_the_edge(chromium, address, width):
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.goto(address)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    blocks = page.evaluate(
        "[...document.querySelectorAll('section, header, p, dl')]"
        ".filter(e => e.scrollWidth > e.clientWidth + 1).length"
    )
    assert blocks == 0
    page.close()


@pytest.mark.parametrize("width", [400, 1280])
def test_what_scrolls_is_reached_by_keyboard_and_has_a_name(chromium, address, width):
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.goto(address)
    assert_reachable(page)
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(chromium, address, scheme):
    page = chromium.new_page(color_scheme=scheme)
    page.goto(address)
    page.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true; })")
    assert_accessible(page)
    page.close()


def test_figures_follow_the_dark(chromium, address):
    seen = []
    for scheme in ("light", "dark"):
        page = chromium.new_page(color_scheme=scheme)
        page.goto(address)
        style = "getComputedStyle(document.querySelector('svg path')).fill"
        paper = "getComputedStyle(document.querySelector('section')).backgroundColor"
        seen.append((page.evaluate(style), page.evaluate(paper)))
        page.close()
    (light_figure, light_page), (dark_figure, dark_page) = seen
    assert light_figure == light_page == "rgb(255, 255, 255)"
    assert dark_figure == dark_page == "rgb(26, 33, 42)"


def test_the_print_has_a_watermark_on_every_page(chromium, address):
    page = chromium.new_page()
    page.goto(address)
    seen = []
    for medium in ("screen", "print"):
        page.emulate_media(media=medium)
        mark = "getComputedStyle(document.querySelector('.watermark'))"
        seen.append(page.evaluate(f"(s => [s.display, s.position])({mark})"))
    page.close()
    assert seen[0][0] == "none"
    assert seen[1] == ["block", "fixed"]  # what is fixed is printed on each page


def test_it_prints_on_a4_with_numbered_pages(chromium, address):
    page = chromium.new_page()
    page.goto(address)
    printed = page.pdf(prefer_css_page_size=True)
    page.close()
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed)
    assert len(boxes) >= 3
    assert {(round(float(w)), round(float(h))) for w, h in boxes} == {(595, 842)}
    if which("pdftotext") is None:
        pytest.skip("pdftotext is not installed: apt install poppler-utils")
    text = run(["pdftotext", "-layout", "-", "-"], input=printed, capture_output=True, check=True)
    pages = text.stdout.decode().split("\f")[:-1]
    assert len(pages) == len(boxes)
    for number, shown in enumerate(pages, start=1):
        assert f"Page {number} of {len(pages)}" in shown
        assert "No. K-2026-17" in shown
        assert re.search(r"SHA-256 [0-9a-f]{16}…", shown)
        assert "SIMULATED: no calibration of a real table" in shown
    assert "ECC lies between" in pages[0]
    assert re.search(r"330\s+−1\.50\s+0\.80", pages[0])
    assert "method: tracer_multistation" in pages[-1]
    assert "End of report K-2026-17" in pages[-1]
