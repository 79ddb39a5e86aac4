"""A rotary axis and its six deviations: their names, and how people see them."""

from __future__ import annotations

import re
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE

TRANSLATIONS: Final = ("EXC", "EYC", "EZC")
"""ISO 230-1 names, in metres."""
ROTATIONS: Final = ("EAC", "EBC", "ECC")
"""ISO 230-1 names, in radians."""
COMPONENTS: Final = (*TRANSLATIONS, *ROTATIONS)

COVERAGE_FACTOR: Final = 2.0
"""People see expanded uncertainties U = k u with this k; files hold k = 1."""
HALF_OF_95_PERCENT: Final = 1.959963984540054
"""Standard deviations of a normal distribution in half an interval of exactly 95 %."""


SHOWN_IN: Final = {"m": (MICROMETRE, "µm"), "rad": (ARCSEC, "arcsec")}
"""Factor and label of the unit in which people read small lengths and angles."""


def unit_of(component: str) -> tuple[float, str]:
    """Return factor and label of the unit in which a deviation is shown.

    Raises ConfigurationError for a name that is none of ISO 230-1, such as EXC, EAA or YOA.

    >>> import rotcal_ros as rc
    >>> factor, label = rc.unit_of("ECC")
    >>> f"{2 * rc.ARCSEC / factor:g} {label}"
    '2 arcsec'
    """
    if not re.fullmatch(r"E[XYZABC][ABC]|[XYZABC]O[ABC]", str(component)):
        raise ConfigurationError(
            f"{component!r} is no deviation of a rotary axis: expected one of "
            f"{', '.join(COMPONENTS)}"
        )
    return SHOWN_IN["rad" if component.strip("EO")[0] in "ABC" else "m"]


def check_axis(axis: str) -> str:
    """Return ``axis`` if a controller file can hold it, else raise ConfigurationError."""
    if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", axis):
        raise ConfigurationError(
            f"axis name {axis!r}: expected a capital letter followed by at most 15 capitals, "
            "digits or underscores, such as C or C1"
        )
    return axis
