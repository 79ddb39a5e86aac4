"""Texts that people read, in their language: English in the code, others in catalogues.

A text has places ``{0}``, ``{1}`` ... for what differs. Catalogues are files of gettext,
``translations/LANGUAGE.po``; what a catalogue lacks stays English.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

FOLDER: Final = Path(__file__).with_name("translations")
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
class Language:
    """One language: ``texts`` are English ones with their translations."""

    code: str = "en"
    texts: Mapping[str, str] | None = None

    def __call__(self, template: str, *parts: object) -> str:
        """Return a text of the catalogue in this language, with its places filled."""
        spoken = (self.say(part) if isinstance(part, str) else part for part in parts)
        text = (self.texts or {}).get(template, template)
        return text.format(*spoken) if parts else text

    def say(self, text: str) -> str:
        """Return a phrase in this language, any other text as it is."""
        return self(text.template, *text.parts) if isinstance(text, Phrase) else text


ENGLISH: Final = Language()


def codes() -> tuple[str, ...]:
    """Return the languages that there are, English first."""
    return (ENGLISH.code, *sorted(path.stem for path in FOLDER.glob("*.po")))


@cache
def language(code: str) -> Language:
    """Return a language; raises ConfigurationError where there is no catalogue of it."""
    if code == ENGLISH.code:
        return ENGLISH
    if code not in codes():
        raise ConfigurationError(
            f"there is no catalogue for the language {code!r}: choose {' or '.join(codes())}"
        )
    entries = _ENTRY.findall((FOLDER / f"{code}.po").read_text(encoding="utf-8") + "\n")
    texts = {_joined(english): _joined(translated) for english, translated in entries}
    return Language(code, {english: text for english, text in texts.items() if english and text})


def _joined(lines: str) -> str:
    """Return the text of quoted lines; those of gettext are strings of JSON."""
    return "".join(json.loads(line) for line in lines.splitlines())
