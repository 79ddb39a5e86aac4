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
_ACTUAL: Final = re.compile(
    r"^[ \t]*FA\(([^)\n]+)\)[ \t]*=[ \t]*FEAT/(?:SPHERE|POINT|CIRCLE)((?:,[ \t]*[A-Z]+)*)"
    r"((?:,[ \t]*[-+.\dEe]+){3})",
    re.MULTILINE,
)


def read(text: str) -> list[tuple[str, ...]] | None:
    """Return the rows of a table, its head first; None for a text that is no such file.

    Raises BagError where no unit is stated, or places are not Cartesian.
    """
    found = _ACTUAL.findall(text.replace("$\n", "").replace("$\r\n", ""))
    if not found:
        return None
    stated = _UNITS.search(text)
    unit = UNITS.get(stated[1]) if stated else None
    if unit is None:
        raise BagError(f"no UNITS/ with one of {', '.join(UNITS)}: add the line of the program")
    if polar := next((name for name, words, _ in found if "CART" not in words), ""):
        raise BagError(f"the place of {polar} is not Cartesian (CART): set the output so")
    places = ([part.strip() for part in numbers.split(",")[1:]] for _, _, numbers in found)
    head = ("name", *(f"{axis} [{unit}]" for axis in "xyz"))
    return [head, *((name, *place) for (name, _, _), place in zip(found, places, strict=True))]
