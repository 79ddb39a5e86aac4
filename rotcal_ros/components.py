"""The six deviations of a rotary table: their names, and how people are shown them."""

from __future__ import annotations

from typing import Final

from rotcal_ros.units import ARCSEC, MICROMETRE

TRANSLATIONS: Final = ("EXC", "EYC", "EZC")
"""ISO 230-1 names, in metres."""
ROTATIONS: Final = ("EAC", "EBC", "ECC")
"""ISO 230-1 names, in radians."""
COMPONENTS: Final = (*TRANSLATIONS, *ROTATIONS)

COVERAGE_FACTOR: Final = 2.0
"""People are shown expanded uncertainties U = k u with this k; files hold k = 1."""


def unit_of(component: str) -> tuple[float, str]:
    """Return factor and label of the unit in which a deviation is shown."""
    return (MICROMETRE, "µm") if component in TRANSLATIONS else (ARCSEC, "arcsec")
