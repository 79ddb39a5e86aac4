"""Figures inside a page: with a name for those who hear it, and in the colours of its scheme.

A figure alone, in a file, keeps its own colours; within a page they follow the custom properties
``--figure-...``, which the page sets for the dark.
"""

from __future__ import annotations

import re
from html import escape
from typing import Final

from rotcal_ros.figures import style
from rotcal_ros.foundation.escapes import printable

PROPERTIES: Final = {
    style.INK: "ink",
    style.BLUE: "blue",
    style.ORANGE: "orange",
    style.GREEN: "green",
    style.RED: "red",
    style.GREY: "grey",
    style.MISSING: "missing",
    style.GRID: "grid",
    style.PAPER: "paper",
}
"""The colours of the house and the custom properties that stand for them."""

_COLOUR: Final = re.compile("|".join(PROPERTIES))


def inline(svg: str, name: str) -> str:
    """Return ``svg`` named for screen readers, with the colours of the page that it stands in."""
    attributes = f'<svg role="img" aria-label="{escape(printable(name))}" '
    coloured = _COLOUR.sub(lambda found: _property(found[0]), svg)
    return coloured.replace("<svg ", attributes, 1)


def _property(colour: str) -> str:
    return f"var(--figure-{PROPERTIES[colour]}, {colour})"
