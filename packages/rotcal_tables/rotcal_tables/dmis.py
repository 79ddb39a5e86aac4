"""Output of a measuring machine in DMIS: the centres of measured features, by name.

``UNITS/MM`` states the unit; ``FA(NAME)=FEAT/SPHERE,CART,x,y,z,diameter`` is an actual feature,
``F(NAME)`` a nominal one, which is left out. docs/deviations.md says what this was looked up in.
"""

from __future__ import annotations

import re
from typing import Final

from rotcal_ros.foundation.errors import BagError

UNITS: Final = {"MM": "mm", "CM": "cm", "M": "m", "METER": "m", "INCH": "in", "FEET": "ft"}
_UNITS: Final = re.compile(r"^[ \t]*UNITS/([A-Z]+)", re.MULTILINE)
_SYSTEM: Final = re.compile(r"^[ \t]*(?:DA?\([^)\n]+\)[ \t]*=|RECALL/DA?\()", re.MULTILINE)
"""A datum or a coordinate system begins, or is taken up again."""
_ACTUAL: Final = re.compile(
    r"^[ \t]*FA\(([^)\n]+)\)[ \t]*=[ \t]*FEAT/(?:SPHERE|POINT|CIRCLE)((?:,[ \t]*[A-Z]+)*)"
    r"((?:,[ \t]*[-+.\dEe]+){3})",
    re.MULTILINE,
)


def read(text: str) -> list[tuple[str, ...]] | None:
    """Return the rows of a table, its head first; None for a text that is no such file.

    Raises BagError where no unit is stated or two are, the coordinate system changes between
    features, or places are not Cartesian.
    """
    text = text.replace("$\n", "").replace("$\r\n", "")
    every = list(_ACTUAL.finditer(text))
    if not every:
        return None
    found = [feature.groups() for feature in every]
    stated = dict.fromkeys(_UNITS.findall(text))
    unit = UNITS.get(next(iter(stated), ""))
    if len(stated) > 1:
        raise BagError(f"UNITS/ changes, {' and '.join(stated)}: set the output to one unit")
    if system := _SYSTEM.search(text, every[0].end(), every[-1].start()):
        raise BagError(
            f"{system[0].strip()!r} changes the coordinate system between features, whose places "
            "are then not of one: output them all in that of the machine"
        )
    if unit is None:
        raise BagError(f"no UNITS/ with one of {', '.join(UNITS)}: add the line of the program")
    if polar := next((name for name, words, _ in found if "CART" not in words), ""):
        raise BagError(f"the place of {polar} is not Cartesian (CART): set the output so")
    places = ([part.strip() for part in numbers.split(",")[1:]] for _, _, numbers in found)
    head = ("name", *(f"{axis} [{unit}]" for axis in "xyz"))
    return [head, *((name, *place) for (name, _, _), place in zip(found, places, strict=True))]
