"""Writes a page in the form that its file name states: HTML as it is, PDF as Chromium prints it.

Chromium is used instead of a Python library, because the page's rules for print (running lines,
page numbers, the watermark of a simulation, opened details) are made for browsers and tested in
one. So the PDF is what every browser prints.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.files import replace_atomically, write_atomically, write_durably

HTML: Final = ".html"
PDF: Final = ".pdf"
BROWSERS: Final = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge",
)  # fmt: skip
_TIMEOUT_S: Final = 120.0
_OPTIONS: Final = (
    "--headless", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--no-pdf-header-footer",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip


def require_writable(page: Path) -> None:
    """Raise ConfigurationError if no page can be written under this name."""
    if page.suffix.lower() not in (HTML, PDF, ""):
        raise ConfigurationError(
            f"{page}: a report is written as {HTML} or {PDF}: expected one of these endings, "
            f"found {page.suffix}"
        )
    if page.suffix.lower() == PDF:
        find_browser()


def find_browser() -> str:
    """Return the path of the browser that prints; ConfigurationError where there is none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise ConfigurationError(
            "printing a PDF needs Chromium, which is not on this machine: apt install chromium, "
            f"or name a {HTML} file and print it to PDF from any browser"
        )
    return found


def write_page(page: Path, text: str) -> None:
    """Write a page, HTML ``text``, in the form that the ending of ``page`` names.

    Raises ConfigurationError for another ending, and for a PDF that cannot be printed.
    """
    require_writable(page)
    if page.suffix.lower() == PDF:
        data = html_to_pdf(text)
        replace_atomically(page, lambda temporary: write_durably(temporary, data))
    else:
        write_atomically(page, text)


def html_to_pdf(text: str) -> bytes:
    """Return HTML as PDF; the browser has no network and leaves no files."""
    with TemporaryDirectory(prefix="rotcal-print-") as name:
        folder = Path(name)
        source, target = folder / f"page{HTML}", folder / f"page{PDF}"
        source.write_text(text, encoding="utf-8")
        # The sandbox needs rights that root gives up for it, which in a container it cannot.
        root = ["--no-sandbox"] if os.geteuid() == 0 else []
        words = _run([
            find_browser(), *_OPTIONS, *root, f"--user-data-dir={folder / 'profile'}",
            f"--print-to-pdf={target}", source.as_uri(),
        ])  # fmt: skip
        data = target.read_bytes() if target.is_file() else b""
    if not data.startswith(b"%PDF-"):
        raise ConfigurationError(
            f"{find_browser()} made no PDF ({words or 'it does not say why'}): name a {HTML} file "
            "and print it from a browser"
        )
    return data


def _run(command: list[str]) -> str:
    """Run a browser with all its processes to its end; return its last line of errors."""
    child = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        _, errors = child.communicate(timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"it did not end within {_TIMEOUT_S:g} s"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
    lines = errors.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""
