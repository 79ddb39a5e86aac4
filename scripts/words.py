"""Brings the catalogues of other languages up to date with the texts of pages and reports.

usage: python scripts/words.py            all catalogues: new texts are added, those not used go
       python scripts/words.py LANGUAGE   begins a catalogue (a code of ISO 639-1, such as fr)
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import get_args

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po, write_po

from rotcal_ros.evaluation.budget import WHOLE
from rotcal_ros.extensions.page.web import asked_settings
from rotcal_ros.foundation.language import FOLDER
from rotcal_ros.foundation.node_state import INSTRUCTIONS, REASONS, STATES
from rotcal_ros.foundation.protection import ALL_EFFECTS, Treatment
from rotcal_ros.methods import find_method, method_names

PACKAGE = Path(__file__).parents[1] / "rotcal_ros"
PAGES = PACKAGE / "extensions" / "page" / "static"
READ = [("**/templates/**.j2", "jinja2"), ("**/static/*.js", "javascript"), ("**.py", "python")]
OPTIONS = {"**/static/*.js": {"template_string": False}}
MARKS = {"phrase": None, "noted": None, "t": None}
DATA = (
    "ok", "suspect", "failed", "measurement", "tolerance", "within", "beyond", "undecided",
    "tracker", "tracer", "laser", "mirror", "plate", "cmm", "rotary table", "machine",
    "ball plate", "thermometer", "barometer", "hygrometer",
)  # fmt: skip
"""Words that come as data."""


class Shown(HTMLParser):
    """The texts of a page, and its names for screen readers."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def handle_data(self, data: str) -> None:
        """Take a text between tags."""
        self.texts.append(" ".join(data.split()))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take the name of an element."""
        self.texts += [value or "" for name, value in attrs if name == "aria-label"]


def used() -> dict[str, str]:
    """Return every text that a catalogue has to know, and where it is first used."""
    found: dict[str, str] = {}
    for name, _, message, _, _ in extract_from_dir(PACKAGE, READ, OPTIONS, keywords=MARKS):
        found.setdefault(message if isinstance(message, str) else message[0], name)
    page = Shown()
    for path in sorted(PAGES.glob("*.html")):
        page.feed(path.read_text(encoding="utf-8"))
    shown = [text for text in page.texts if any(map(str.isalpha, text)) and text != "rotcal"]
    fields = (s["meaning"][0] for name in method_names() for s in asked_settings(name))
    titles = [find_method(name).title for name in method_names()]
    data = (*DATA, *fields, WHOLE, *ALL_EFFECTS, *get_args(Treatment), *titles, *REASONS.values(),
            *STATES.values(), *INSTRUCTIONS.values())  # fmt: skip
    for where, texts in (("static/*.html", shown), ("data", data)):
        for text in texts:
            found.setdefault(text, where)
    return {text: where for text, where in found.items() if any(map(str.isalpha, text))}


def update(code: str) -> None:
    """Write the catalogue of a language with the texts that are used now."""
    path = FOLDER / f"{code}.po"
    catalogue = Catalog(locale=code, project="rotcal_ros", fuzzy=False)
    if path.exists():
        with path.open("rb") as file:
            catalogue = read_po(file, locale=code)
    template = Catalog(project="rotcal_ros", fuzzy=False)
    for text, where in used().items():
        template.add(text, locations=[(where, 0)])
    catalogue.update(template, no_fuzzy_matching=True)
    catalogue.obsolete.clear()
    with path.open("wb") as file:
        write_po(file, catalogue, width=0, omit_header=True, include_lineno=False)


if __name__ == "__main__":
    for language in sys.argv[1:] or [path.stem for path in FOLDER.glob("*.po")]:
        update(language)
