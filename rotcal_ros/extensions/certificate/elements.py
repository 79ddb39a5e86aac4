"""The elements that certificates are built of: namespaces, texts, lists of numbers with units."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from lxml.builder import ElementMaker

from rotcal_ros.foundation.escapes import printable, printable_lines

DCC_NAMESPACE: Final = "https://ptb.de/dcc"
SI_NAMESPACE: Final = "https://ptb.de/si"
PREFIXES: Final = {"dcc": DCC_NAMESPACE, "si": SI_NAMESPACE}
DCC: Final = ElementMaker(namespace=DCC_NAMESPACE, nsmap=PREFIXES)
SI: Final = ElementMaker(namespace=SI_NAMESPACE, nsmap=PREFIXES)
LANGUAGE: Final = "en"


def text(tag: str, *paragraphs: str, **attributes: str) -> Any:
    """Return an element with localised text."""
    contents = [DCC.content(printable_lines(p), lang=LANGUAGE) for p in paragraphs]
    return DCC(tag, *contents, **attributes)


def leaf(tag: str, value: str) -> Any:
    """Return an element with one word or number; runs of blanks become one, as the schema asks."""
    return DCC(tag, printable(" ".join(value.split())))


def present(*elements: Any) -> list[Any]:
    """Return those elements that are there."""
    return [element for element in elements if element is not None]


def numbers(values: Iterable[float]) -> str:
    """Return numbers as a list of the schema; every bit survives."""
    return " ".join(repr(float(value)) for value in values)


def contact(tag: str, name: str, address: str = "", email: str = "", country: str = "") -> Any:
    """Return a person or an organisation; one that has an address has a location."""
    location = None
    if address:
        further = text("further", address)
        location = DCC.location(
            *present(leaf("countryCode", country) if country else None, further)
        )
    mail = leaf("eMail", email) if email else None
    return DCC(tag, *present(text("name", name), mail, location))


def identification(issuer: str, value: str, name: str) -> Any:
    """Return a number by which something is known, and who gave it."""
    return DCC.identification(leaf("issuer", issuer), leaf("value", value), text("name", name))
