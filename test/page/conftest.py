"""The page in a real browser, without a cell: a board that a test fills."""

import sys
from concurrent.futures import Future
from pathlib import Path

import pytest
from browser import launched

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("nodes", "compensation")]

from live_cell import cell, rotcal  # noqa: F401


class Nobody:
    """Says that it was done, whatever is asked for; ``asked`` notes it."""

    def __init__(self):
        self.asked = []

    def __getattr__(self, name):
        def answer(*arguments):
            from rotcal_ros.page.app import ActionOutcome

            self.asked.append((name, *arguments))
            future = Future()
            future.set_result(ActionOutcome(True, "done"))
            return future

        return answer


@pytest.fixture(scope="module")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as running:
        browser = launched(running)
        yield browser
        browser.close()


@pytest.fixture
def shown(chromium):
    """Return what opens a page that shows sections; ``shown.board`` can be changed later."""
    pytest.importorskip("starlette")
    from rotcal_ros.page.app import PageServer
    from rotcal_ros.page.settings import PageSettings
    from rotcal_ros.page.state import StateBoard

    board, nobody, pages, errors = StateBoard(), Nobody(), [], []
    server = PageServer(PageSettings(), board, nobody)

    def open_page(sections, scheme="light", size=(1280, 1500), **options):
        board.show(**sections)
        viewport = {"width": size[0], "height": size[1]}
        page = chromium.new_page(viewport=viewport, color_scheme=scheme, **options)
        pages.append(page)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(server.address)
        page.wait_for_selector("body.live")
        return page

    open_page.board, open_page.asked = board, nobody.asked
    yield open_page
    for page in pages:
        page.close()
    server.close()
    assert errors == []
