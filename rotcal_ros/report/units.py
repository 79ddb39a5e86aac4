"""The units in which deviations are shown."""

from __future__ import annotations

from rotcal_ros.units import ARCSEC, MICROMETRE


def unit_of(component: str) -> tuple[float, str]:
    """Return factor and label of the unit in which a deviation is shown."""
    return (MICROMETRE, "µm") if component in ("EXC", "EYC", "EZC") else (ARCSEC, "arcsec")
