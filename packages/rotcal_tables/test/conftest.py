"""Helpers of the core's tests: a browser, the language of pages."""

import sys
from pathlib import Path

import pytest
from browser import launched

sys.path += [str(Path(__file__).parents[3] / "test" / folder) for folder in ("page", "cli")]


@pytest.fixture(scope="module")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as running:
        browser = launched(running)
        yield browser
        browser.close()
