"""Texts that people read, in their language: English in the code, others in catalogues.

A text has places ``{0}``, ``{1:.3g}`` ... for its arguments. Catalogues are files of gettext,
``translations/LANGUAGE.po``; what a catalogue lacks stays English. Packages beside the core have
catalogues of their own.

A warning, a reason or a refusal is a :class:`Phrase`: its English words, and the code and the
arguments of which they were made. Files and messages carry both, see :func:`codes_of`, so that a
stored one speaks every language. Nothing reads the words back.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError

FOLDER: Final = Path(__file__).with_name("translations")
PACKAGES: Final = "rotcal_ros.translations"
"""Entry points of packages that have a folder ``translations``: any name -> the package."""
DEPTH: Final = 8
"""Phrases in arguments of phrases: this far down they are read from a file."""
_PLAIN: Final = (str, int, float)
_PLACE: Final = re.compile(r"\{(\d+)([^{}]*)\}")
_CODE: Final = re.compile(
    r"(?:[^{}]|\{\{|\}\}|\{\d{1,2}(?:!r)?(?::[+]?(?:\.\d{1,2})?[a-z%]?)?\})*"
)
"""Templates that a file may name: their places name a format, and reach into nothing."""
_ENTRY: Final = re.compile(r'^msgid ((?:".*"\n)+)msgstr ((?:".*"\n)+)', re.MULTILINE)


class Phrase(str):
    """A text in English that knows how it was made: its code, and what fills its places.

    The code is the ``template``, which is what a catalogue translates. Of ``parts``, numbers are
    as they were, texts are names that no language changes, and phrases are translated in turn.
    """

    __slots__ = ("parts", "template")
    template: str
    parts: tuple[str | int | float, ...]

    def __str__(self) -> str:
        """Return the phrase itself: an exception or a figure that holds it gives it back."""
        return self

    @property
    def text(self) -> str:
        """The English words alone."""
        return str.__str__(self)

    def has(self, code: str) -> bool:
        """Return whether it is the text with this code, or one of its parts is."""
        parts = (part for part in self.parts if isinstance(part, Phrase))
        return self.template == code or any(part.has(code) for part in parts)

    @property
    def shown(self) -> list[str]:
        """The parts as the text shows them, phrases as they are."""
        forms = dict(_PLACE.findall(self.template))
        return [
            part if isinstance(part, str) else f"{{0{forms.get(str(k), '')}}}".format(part)
            for k, part in enumerate(self.parts)
        ]

    @property
    def coded(self) -> dict[str, Any]:
        """The phrase as plain data of JSON: text, code and arguments, phrases in turn."""
        arguments = [
            part.coded if isinstance(part, Phrase)
            else {"number": str(part)} if isinstance(part, float) and not isfinite(part)
            else part
            for part in self.parts
        ]  # fmt: skip
        if not arguments:
            return {"code": self.template}
        return {"text": self.text, "code": self.template, "arguments": arguments}


def noted(template: str) -> str:
    """Mark a text for the catalogues that is filled and translated elsewhere."""
    return template


def phrase(template: str, *parts: object) -> Phrase:
    """Return a text for the catalogues, with its places filled; a phrase stays as it is.

    >>> phrase("table position {0}, off by {1:.1f} mm", 5, 0.25)
    'table position 5, off by 0.2 mm'
    """
    if isinstance(template, Phrase) and not parts:
        return template
    kept = tuple(map(_kept, parts))
    whole = Phrase(template.format(*kept) if kept else template)
    whole.template, whole.parts = template, kept
    return whole


def _kept(part: object) -> str | int | float:
    """Return a part of a phrase as JSON can hold it: numbers of numpy as plain ones."""
    if isinstance(part, _PLAIN) and type(part).__module__ != "numpy":
        return part
    plain = part.item() if hasattr(part, "item") else part
    return plain if isinstance(plain, _PLAIN) else str(plain)


def join_texts(texts: Sequence[str], separator: str = "; ") -> Phrase:
    """Return texts one after the other; phrases among them stay phrases."""
    places = separator.join(f"{{{place}}}" for place in range(len(texts)))
    return phrase(texts[0]) if len(texts) == 1 else phrase(places, *texts)


def code_of(text: str) -> tuple[str, list[str]]:
    """Return code and arguments of a text for a message, which has the words beside them.

    Arguments are in JSON; a text without a code has neither.

    >>> code_of(phrase("table position {0}, {1}", 5, phrase("off by {0:.1f} mm", 0.25)))[1]
    ['5', '{"text": "off by 0.2 mm", "code": "off by {0:.1f} mm", "arguments": [0.25]}']
    """
    if not isinstance(text, Phrase):
        return "", []
    return text.template, [json.dumps(argument) for argument in text.coded.get("arguments", ())]


def phrase_of(text: str, code: str, arguments: Sequence[str]) -> Phrase:
    """Return the text of a message that has these, as :func:`code_of` gives them.

    Words without a code, as in bags of before, and such as it does not give, are their own code.
    """
    with suppress(ValueError, RecursionError):
        given = [json.loads(argument) for argument in arguments]
        if given and (found := _read({"text": text, "code": code, "arguments": given})):
            return found
    return phrase(text)


NOTHING: Final = join_texts(())
"""The text without words: no reason."""


def codes_of(texts: Any) -> list[dict[str, Any]]:
    """Return every phrase with arguments among ``texts`` once, as plain data of JSON.

    A text of ours that is not among them is its own code.
    """
    found: dict[str, Phrase] = {}
    for text in _phrases(texts):
        found.setdefault(text, text)
    return [text.coded for text in found.values()]


def _phrases(texts: Any) -> Iterator[Phrase]:
    if isinstance(texts, Phrase):
        if texts.parts:
            yield texts
    elif isinstance(texts, Mapping | list | tuple):
        for text in texts.values() if isinstance(texts, Mapping) else texts:
            yield from _phrases(text)


def with_codes(texts: Any, coded: Any) -> Any:
    """Return plain data with its texts as the phrases that :func:`codes_of` made of them."""
    known = {
        str.__str__(text): text
        for text in map(_read, coded if isinstance(coded, list) else ())
        if text
    }
    return _spoken_again(texts, known) if known else texts


def _spoken_again(texts: Any, known: Mapping[str, Phrase]) -> Any:
    if isinstance(texts, str):
        return known.get(texts, texts)
    if isinstance(texts, Mapping):
        return {name: _spoken_again(text, known) for name, text in texts.items()}
    return [_spoken_again(t, known) for t in texts] if isinstance(texts, list) else texts


def _read(coded: Any, depth: int = DEPTH) -> Phrase | None:
    """Return a phrase of plain data; None if code and arguments do not give its text."""
    match coded:
        case {"code": str(code)} if len(coded) == 1:
            return phrase(code)
        case {"text": str(text), "code": str(code), "arguments": list(given)} if depth:
            parts = [_argument(argument, depth) for argument in given]
            if None in parts or not _CODE.fullmatch(code):
                return None
            try:
                found = phrase(code, *parts)
            except (IndexError, OverflowError, ValueError):
                return None
            return found if found == text else None
    return None


def _argument(given: Any, depth: int) -> str | int | float | None:
    match given:
        case {"number": "inf" | "-inf" | "nan" as number}:
            return float(number)
        case str() | int() | float():
            return given
    return _read(given, depth - 1)


@dataclass(frozen=True, slots=True)
class Language:
    """One language: ``texts`` are English ones, with their places, and their translations."""

    code: str = "en"
    texts: Mapping[str, str] | None = None

    def __call__(self, template: str, *parts: object) -> str:
        """Return a text of the catalogue in this language, with its places filled."""
        if not parts:
            return self.say(template) if isinstance(template, Phrase) else self._known(template)
        spoken = (self.say(part) if isinstance(part, str) else part for part in parts)
        return self._known(template).format(*spoken)

    def say(self, text: str) -> str:
        """Return a phrase in this language, any other text as it is."""
        if not isinstance(text, Phrase):
            return text
        return self(text.template, *text.parts) if text.parts else self._known(text.template)

    def has_translation(self, text: Phrase) -> bool:
        """Return whether a phrase is of this language: words of its own are in the catalogue."""
        template = text.template
        return self.texts is None or bool(text.parts) or self._known(template) != template

    def _known(self, template: str) -> str:
        """Return the translation; one that only begins with a capital is that without it."""
        texts = self.texts or {}
        if template in texts or not template[:1].isupper():
            return texts.get(template, template)
        small = texts.get(template[:1].lower() + template[1:])
        return small[:1].upper() + small[1:] if small else template


ENGLISH: Final = Language()
SPOKEN: Final[ContextVar[Language]] = ContextVar("SPOKEN", default=ENGLISH)
"""The language of what is drawn and rendered now."""


@contextmanager
def use_language(code: str) -> Iterator[None]:
    """Draw and render in another language: phrases, and what is ours in a page or a figure."""
    token = SPOKEN.set(language(code))
    try:
        yield
    finally:
        SPOKEN.reset(token)


def language_codes() -> tuple[str, ...]:
    """Return the languages that there are, English first."""
    return (ENGLISH.code, *sorted(path.stem for path in FOLDER.glob("*.po")))


@cache
def catalogue_folders() -> tuple[Path, ...]:
    """Return the folders of catalogues: ours, and those of installed packages."""
    places = (find_spec(point.module) for point in entry_points(group=PACKAGES))
    origins = (Path(place.origin) for place in places if place and place.origin)
    return (FOLDER, *sorted(origin.with_name("translations") for origin in origins))


@cache
def language(code: str) -> Language:
    """Return a language; raises ConfigurationError where there is no catalogue of it."""
    if code == ENGLISH.code:
        return ENGLISH
    if code not in language_codes():
        raise ConfigurationError(
            f"there is no catalogue for the language {code!r}: "
            f"choose {' or '.join(language_codes())}"
        )
    files = [path for folder in catalogue_folders() if (path := folder / f"{code}.po").exists()]
    entries = [e for f in files for e in _ENTRY.findall(f.read_text(encoding="utf-8") + "\n")]
    texts = {_joined(english): _joined(translated) for english, translated in entries}
    return Language(code, {english: text for english, text in texts.items() if english and text})


def _joined(lines: str) -> str:
    """Return the text of quoted lines; those of gettext are strings of JSON."""
    return "".join(json.loads(line) for line in lines.splitlines())
