"""Brings the catalogues of other languages up to date with the texts of pages and reports.

Texts that are marked, or stand in a call that shows them, are asked for. What else the code
writes, such as a warning, is asked for as soon as one catalogue has it.

usage: python scripts/words.py            all catalogues: new texts are added, those not used go
       python scripts/words.py LANGUAGE   begins a catalogue (a code of ISO 639-1, such as fr)
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import get_args

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_file
from babel.messages.pofile import read_po, write_po

from rotcal_ros.evaluation.budget import WHOLE
from rotcal_ros.foundation.identity import Instruments
from rotcal_ros.foundation.language import FOLDER, catalogue_folders, language
from rotcal_ros.foundation.node_state import INSTRUCTIONS, REASONS, STATES
from rotcal_ros.foundation.plugins import METHODS, provider
from rotcal_ros.foundation.protection import ALL_EFFECTS, Treatment
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.angle_comparison.model import INSTRUMENT, MOVED, REFERENCE, WORDS
from rotcal_ros.methods.ball_plate.solver.plate_model import AGAIN

PACKAGE = Path(__file__).parents[1] / "rotcal_ros"
READ = [
    ("**/templates/**/*.j2", "jinja2"),
    ("**/static/*.js", "javascript"),
    ("**/*.py", "python"),
]
OPTIONS = {"javascript": {"template_string": False}}
MARKS = {"phrase": None, "noted": None, "t": None}
MARKED = re.compile(rf"\b(?:{'|'.join(MARKS)})\(")
SHOWN_BY = (
    "Figure", "Protection", "angle_axis", "set_xlabel", "set_ylabel", "set_title", "Words",
    "Disturbing", "Grouping", "KnownBeforehand", "with_prior", "scattering", "Otherwise",
    "AttemptRejectedError",
)  # fmt: skip
"""Calls whose texts of several words come onto a page, or are arguments of codes."""
UNIT = re.compile("_(deg|mm|um|arcsec)$")
"""At the end of a head of a table, of which the page says the rest."""
DATA = (
    "ok", "suspect", "failed", "measurement", "tolerance", "within", "beyond", "undecided",
    "laser", "plate", "cmm", "rotary table",
    *(field.name.replace("_", " ") for field in fields(Instruments)),
    INSTRUMENT, MOVED, WORDS.elements, REFERENCE, AGAIN,
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
    for name, message in marked(PACKAGE):
        found.setdefault(message, name)
    shown = shown_on_pages(PACKAGE)
    ours = [name for name in method_names() if not provider(name, METHODS)]
    titles = [find_method(name).title for name in ours]
    data = (*DATA, WHOLE, *ALL_EFFECTS, *get_args(Treatment), *titles, *REASONS.values(),
            *STATES.values(), *INSTRUCTIONS.values())  # fmt: skip
    of_calls = [(where, tuple(texts)) for where, texts in shown_texts().items()]
    for where, texts in (*of_calls, ("static/*.html", tuple(shown)), ("data", data)):
        for text in texts:
            found.setdefault(text, where)
    return {text: where for text, where in found.items() if has_words(text)}


def has_words(text: str) -> bool:
    """Return whether a text has letters beside its places."""
    return any(map(str.isalpha, re.sub(r"\{[^{}]*\}", "", text)))


def shown_on_pages(package: Path) -> list[str]:
    """Return the texts of a package's pages of HTML."""
    page = Shown()
    for path in sorted(package.glob("**/static/*.html")):
        page.feed(path.read_text(encoding="utf-8"))
    return [text for text in page.texts if any(map(str.isalpha, text)) and text != "rotcal"]


def marked(package: Path) -> Iterator[tuple[str, str]]:
    """Yield the file of every marked text of a package, and the text."""
    for pattern, kind in READ:
        for path in sorted(package.glob(pattern)):
            if MARKED.search(path.read_text(encoding="utf-8")):  # most have none
                options = OPTIONS.get(kind)
                for _, message, _, _ in extract_from_file(kind, path, MARKS, options=options):
                    text = message if isinstance(message, str) else message[0]
                    yield str(path.relative_to(package)), text


def written() -> dict[str, str]:
    """Return every text in the code with its places, marked or not, and where it is."""
    return {
        text: where
        for where, nodes in modules().items()
        for node in nodes
        for text in texts_of(node)
    }


def shown_texts() -> dict[str, list[str]]:
    """Return, by file, the texts of several words in calls that show them."""
    return {
        where: [
            text
            for call in nodes
            if isinstance(call, ast.Call) and ast.unparse(call.func).split(".")[-1] in SHOWN_BY
            for argument in (*call.args, *(keyword.value for keyword in call.keywords))
            for text in texts_of(argument)
            if " " in text and set(re.findall("[a-z]{2,}", text)) - {"mm", "arcsec"}
        ]
        for where, nodes in modules().items()
    }


@cache
def modules() -> dict[str, list[ast.AST]]:
    """Return all syntax in the files of the package by their names."""
    return {
        str(path.relative_to(PACKAGE)): [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
        for path in sorted(PACKAGE.rglob("*.py"))
    }


def texts_of(node: ast.AST) -> Iterator[str]:
    """Yield the texts that a piece of code is: of a constant, a name, or with places {0}, {1}."""
    if isinstance(node, ast.JoinedStr):
        count = iter(range(len(node.values)))
        text = "".join(
            str(part.value) if isinstance(part, ast.Constant) else f"{{{next(count)}}}"
            for part in node.values
        )
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        count = iter(range(len(node.value)))
        text = re.sub(r"\{(:[^}]*)?\}", lambda _: f"{{{next(count)}}}", node.value)
    elif isinstance(node, ast.keyword) and node.arg:
        text = node.arg
    else:
        return
    yield text
    if " " not in text:
        yield UNIT.sub("", text).removeprefix("U_").replace("_", " ")


def wanted(folder: Path = FOLDER) -> dict[str, str]:
    """Return what a catalogue has to have: what is used, and what another one has.

    That of a package beside the core has what is marked there, on its pages and what it calls
    ``translated``, and not in the core's.
    """
    if folder != FOLDER:
        ours, package = wanted(), folder.parent
        theirs = [*marked(package), *(("static/*.html", t) for t in shown_on_pages(package))]
        with suppress(ModuleNotFoundError):
            data = import_module(f"{package.name}.translated").texts()
            theirs += [("data", text) for text in data]
        found = {message: name for name, message in theirs if message not in ours}
        return {text: name for text, name in found.items() if has_words(text)}
    known = {text for path in FOLDER.glob("*.po") for text in language(path.stem).texts or ()}
    return used() | {text: where for text, where in written().items() if text in known}


def update(folder: Path, code: str) -> None:
    """Write the catalogue of a language with the texts that are used now."""
    path, project = folder / f"{code}.po", "rotcal_ros" if folder == FOLDER else folder.parent.name
    catalogue = Catalog(locale=code, project=project, fuzzy=False)
    if path.exists():
        with path.open("rb") as file:
            catalogue = read_po(file, locale=code)
    template = Catalog(project=project, fuzzy=False)
    for text, where in wanted(folder).items():
        template.add(text, locations=[(where, 0)])
    catalogue.update(template, no_fuzzy_matching=True)
    catalogue.obsolete.clear()
    folder.mkdir(exist_ok=True)
    for message in catalogue:
        message.flags.clear()  # a place says itself what it is
    with path.open("wb") as file:
        write_po(file, catalogue, width=0, omit_header=True, no_location=True)


if __name__ == "__main__":
    for code in sys.argv[1:] or [path.stem for path in FOLDER.glob("*.po")]:
        for folder in catalogue_folders():
            update(folder, code)
