"""The page of the park in Chromium: with 3 and with 3,000 tables, and behind a row its entries."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from accessibility import assert_accessible
from browser import launched
from simulated_park import Table, measured

from rotcal_history import page as park_page
from rotcal_history.database import ParkHistory
from rotcal_history.outlook import all_outlooks
from rotcal_history.page import write_park
from rotcal_history.settings import HistorySettings
from rotcal_ros.foundation.language import use_language

sync_api = pytest.importorskip("playwright.sync_api")
pytestmark = pytest.mark.slow
YEARS = np.linspace(0.0, 5.0, 11)
MOST_S = 5.0


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return the folder of the page of three tables, and their outlooks."""
    folder, rng = tmp_path_factory.mktemp("park"), np.random.default_rng(1)
    start = np.append([1.0, 0.5], np.zeros(6))
    with ParkHistory(str(folder / "history.db")) as history:
        for name, drift, jump in (
            ("STAYS", 0.0, None), ("DRIFTS", 0.6, None), ("<HIT>", 0.0, (3.2, 3.0 * np.eye(8)[1])),
        ):  # fmt: skip
            table = Table(name, start, drift=drift * np.eye(8)[0], jump=jump)
            for each in measured(table, YEARS, rng):
                history.add_result(each)
        history.add_document(
            history.item("STAYS"), "report", "report.html", 1, b"<h1>The report</h1>"
        )
        outlooks = all_outlooks(history, HistorySettings())
        write_park(history, outlooks, folder, "2026-03-31")
    return folder, outlooks


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = launched(playwright)
        yield chromium
        chromium.close()


def rows(page):
    return page.locator("#rows tr").all_inner_texts()


def test_three_tables_with_their_reasons_and_reports(small, browser):
    folder, _ = small
    page = browser.new_page()
    errors = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto((folder / "park.html").as_uri())
    found = rows(page)
    assert [text.split("\t")[0] for text in found] == ["<HIT>/C", "DRIFTS/C", "STAYS/C"]
    assert "jumped before" in found[0]
    assert page.locator("#rows svg").count() == 3
    assert_accessible(page)
    page.select_option("#state", "look")
    assert len(rows(page)) == 1
    page.select_option("#state", "")
    page.fill("#words", "drifts")
    assert len(rows(page)) == 1
    page.fill("#words", "")
    page.click("text=STAYS/C")
    assert page.locator("h1").inner_text() == "STAYS/C"
    assert page.locator("svg").count() == 1
    page.click("text=report.html")
    assert page.locator("h1").inner_text() == "The report"
    page.go_back()
    page.click("text=all tables")
    assert len(rows(page)) == 3
    assert errors == []


def test_a_german_reader_finds_no_english(small, browser, tmp_path):
    folder, outlooks = small
    with ParkHistory(str(folder / "history.db")) as history, use_language("de"):
        write_park(history, outlooks, tmp_path, "2026-03-31")
    page = browser.new_page()
    page.goto((tmp_path / "park.html").as_uri())
    assert page.locator("html").get_attribute("lang") == "de"
    assert page.locator("#count").inner_text() == "3 von 3 Tischen"
    assert "den Tisch ansehen" in rows(page)[0]
    texts = [page.inner_text("main")]
    for name in ("<HIT>/C", "DRIFTS/C", "STAYS/C"):
        page.click(f"text={name}")
        texts.append(page.inner_text("main"))
        page.go_back()
    english = {"table", "tables", "the", "is", "result", "of", "days", "year", "due", "within"}
    assert not english & set(re.findall(r"[a-z]+", " ".join(texts).lower()))


def test_three_thousand_tables_are_as_quick_to_look_at(small, browser, tmp_path, monkeypatch):
    _, outlooks = small
    many = [replace(outlooks[n % 3], serial=f"T{n:04}") for n in range(3000)]
    monkeypatch.setattr(park_page, "_table_files", lambda *_: {})
    begun = time.process_time()
    write_park(None, many, tmp_path, "2026-03-31")
    assert time.process_time() - begun < MOST_S
    page = browser.new_page()
    page.goto((tmp_path / "park.html").as_uri())
    assert page.locator("#count").inner_text() == "3000 of 3000 tables"
    assert len(rows(page)) == 100
    page.click("#on")
    assert page.locator("#page").inner_text() == "page 2 of 30"
    page.fill("#words", "T2718")
    assert len(rows(page)) == 1
