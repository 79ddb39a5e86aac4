"""Debian's Chromium for tests of pages: skipped where it is missing, unless it is required."""

import os
import shutil

import pytest

CHROMIUM = shutil.which("chromium")
REQUIRED = bool(os.environ.get("ROTCAL_REQUIRE_CHROMIUM"))


def launched(playwright, **options):
    """Return the browser; skip the test where it is missing, fail where it is required."""
    if CHROMIUM is None:
        if REQUIRED:
            pytest.fail("Chromium is required here (ROTCAL_REQUIRE_CHROMIUM): install chromium")
        pytest.skip("Chromium is not installed: apt install chromium")
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    return playwright.chromium.launch(executable_path=CHROMIUM, args=arguments, **options)
