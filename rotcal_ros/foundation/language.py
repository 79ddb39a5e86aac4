"""Texts that people read, in their language: English in the code, others in catalogues.

A text has places ``{0}``, ``{1}`` ... for what differs. Catalogues are files of gettext,
``translations/LANGUAGE.po``; what a catalogue lacks stays English. Packages beside the core have
catalogues of their own.

Results, bags and logs hold finished English texts. One of these is understood again by the entry
that could have made it, and what fills its places by other entries: so a stored result speaks
every language, however old it is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

FOLDER: Final = Path(__file__).with_name("translations")
PACKAGES: Final = "rotcal_ros.translations"
"""Entry points of packages that have a folder ``translations``: any name -> the package."""
JOINTS: Final = ("; ", ": ", ", ")
"""What stands between texts that were made one by one."""
LONGEST: Final = 4000
"""Letters of a text that is still taken apart."""
MOST_LETTERS: Final = 200
"""Most letters of the words before a mere blank."""
LETTERS: Final = 7
"""An entry with fewer beside its places may have made a text, if no others did piece by piece."""
DEPTH: Final = 6
"""Texts in places of texts: this far down they are understood."""
_COUNTED: Final = re.compile(r"(\d+ |)([^\d].*[^\d])( \d+|)")
_PLACE: Final = re.compile(r"\{(\d+)\}")
_ENTRY: Final = re.compile(r'^msgid ((?:".*"\n)+)msgstr ((?:".*"\n)+)', re.MULTILINE)


class Phrase(str):
    """A text in English that knows how it was made: what a catalogue translates, and the rest.

    ``parts`` fill the places of ``template``: texts as they are, or phrases in turn.
    """

    __slots__ = ("parts", "template")
    template: str
    parts: tuple[str, ...]


def noted(template: str) -> str:
    """Mark a text for the catalogues that is filled and translated elsewhere."""
    return template


def phrase(template: str, *parts: object) -> Phrase:
    """Return a text for the catalogues, with its places filled.

    >>> phrase("table position {0}", 5)
    'table position 5'
    """
    texts = tuple(part if isinstance(part, str) else str(part) for part in parts)
    whole = Phrase(template.format(*texts) if texts else template)
    whole.template, whole.parts = template, texts
    return whole


def listed(texts: Sequence[str], between: str = "; ") -> str:
    """Return texts one after the other; phrases among them stay phrases."""
    places = between.join(f"{{{place}}}" for place in range(len(texts)))
    return texts[0] if len(texts) == 1 else phrase(places, *texts)


@dataclass(frozen=True, slots=True)
class Template:
    """An entry with places: the ``pieces`` between its ``places``, and its translation."""

    pieces: tuple[str, ...]
    places: tuple[int, ...]
    translated: str

    @classmethod
    def of(cls, english: str, translated: str) -> Template:
        """Return an entry of a catalogue, taken apart."""
        parts = _PLACE.split(english)
        return cls(tuple(parts[::2]), tuple(map(int, parts[1::2])), translated)

    @property
    def letters(self) -> int:
        """How many letters a text of this entry has for sure."""
        return sum(map(str.isalpha, "".join(self.pieces)))

    def filling(self, text: str, known: Container[str]) -> list[str] | None:
        """Return what fills the places in ``text``; None if this entry did not make it.

        Each place ends where the next piece begins first, so no text takes long; if that is a
        mere blank, behind the most words that are ``known``.
        """
        first, *between, last = self.pieces
        rest = text.removeprefix(first).removesuffix(last)
        if len(text) != len(first) + len(rest) + len(last):
            return None
        found: dict[int, str] = {}
        for place, piece in zip(self.places, [*between, ""], strict=True):
            end = rest.find(piece) if piece else len(rest)
            if piece == " ":
                blanks = (blank.start() for blank in re.finditer(" ", rest[:MOST_LETTERS]))
                end = max((b for b in blanks if rest[:b] in known), default=end)
            if end < 0:
                return None
            found[place], rest = rest[:end], rest[end + len(piece) :]
        return [found.get(place, "") for place in range(max(found) + 1)]


@dataclass(frozen=True, slots=True)
class Language:
    """One language: ``texts`` are English ones with their translations.

    ``templates`` are those among them that have places, the most specific ones first: those with
    LETTERS, and the rest.
    """

    code: str = "en"
    texts: Mapping[str, str] | None = None
    templates: tuple[Sequence[Template], Sequence[Template]] = ((), ())

    def __call__(self, template: str, *parts: object) -> str:
        """Return a text of the catalogue in this language, with its places filled."""
        if not parts:
            return self.understood(template) or template
        spoken = (self.say(part) if isinstance(part, str) else part for part in parts)
        return (self.texts or {}).get(template, template).format(*spoken)

    def say(self, text: str) -> str:
        """Return a phrase in this language, any other text as it is."""
        return self(text.template, *text.parts) if isinstance(text, Phrase) else text

    def understood(self, text: str, depth: int = DEPTH) -> str | None:
        """Return a finished text of ours in this language; None if no entry made it.

        A text that only begins with a capital is the entry without it.
        """
        if self.texts is None or text in self.texts or not depth or len(text) > LONGEST:
            return None if self.texts is None else self.texts.get(text)
        if lower := self.texts.get(text[:1].lower() + text[1:]):
            return lower[:1].upper() + lower[1:]
        whole, short = self.templates
        return (
            self._filled(whole, text, depth)
            or self._piecewise(text, depth)
            or self._filled(short, text, depth)
            or self._counted(text, depth)
        )

    def _filled(self, templates: Sequence[Template], text: str, depth: int) -> str | None:
        for template in templates:
            filling = template.filling(text, self.texts or ())
            if filling is not None:
                parts = [self.understood(part, depth - 1) or part for part in filling]
                return template.translated.format(*parts)
        return None

    def _piecewise(self, text: str, depth: int) -> str | None:
        for joint in filter(text.__contains__, JOINTS):
            each = [
                self.understood(part, depth - 1) or (None if " " in part else part)
                for part in text.split(joint)
            ]
            if None not in each:
                return joint.join(map(str, each))
        return None

    def _counted(self, text: str, depth: int) -> str | None:
        counted = _COUNTED.fullmatch(text)
        if counted is None or counted[2] == text:
            return None
        words = self.understood(counted[2], depth - 1)
        return words and f"{counted[1]}{words}{counted[3]}"


ENGLISH: Final = Language()
SPOKEN: Final[ContextVar[Language]] = ContextVar("SPOKEN", default=ENGLISH)
"""The language of what is drawn and rendered now."""


@contextmanager
def speaking(code: str) -> Iterator[None]:
    """Draw and render in another language: phrases, and what is ours in a page or a figure."""
    token = SPOKEN.set(language(code))
    try:
        yield
    finally:
        SPOKEN.reset(token)


def codes() -> tuple[str, ...]:
    """Return the languages that there are, English first."""
    return (ENGLISH.code, *sorted(path.stem for path in FOLDER.glob("*.po")))


@cache
def folders() -> tuple[Path, ...]:
    """Return the folders of catalogues: ours, and those of installed packages."""
    places = (find_spec(point.module) for point in entry_points(group=PACKAGES))
    origins = (Path(place.origin) for place in places if place and place.origin)
    return (FOLDER, *sorted(origin.with_name("translations") for origin in origins))


@cache
def language(code: str) -> Language:
    """Return a language; raises ConfigurationError where there is no catalogue of it."""
    if code == ENGLISH.code:
        return ENGLISH
    if code not in codes():
        raise ConfigurationError(
            f"there is no catalogue for the language {code!r}: choose {' or '.join(codes())}"
        )
    files = [path for folder in folders() if (path := folder / f"{code}.po").exists()]
    entries = [e for f in files for e in _ENTRY.findall(f.read_text(encoding="utf-8") + "\n")]
    texts = {_joined(english): _joined(translated) for english, translated in entries}
    texts = {english: text for english, text in texts.items() if english and text}
    templates = [Template.of(*entry) for entry in texts.items() if _PLACE.search(entry[0])]
    specific = sorted(templates, key=lambda template: template.letters, reverse=True)
    whole = [template for template in specific if template.letters >= LETTERS]
    short = [template for template in specific if 0 < template.letters < LETTERS]
    return Language(code, texts, (whole, short))


def _joined(lines: str) -> str:
    """Return the text of quoted lines; those of gettext are strings of JSON."""
    return "".join(json.loads(line) for line in lines.splitlines())
