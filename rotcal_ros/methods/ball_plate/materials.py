"""What ball plates are made of, and how much these materials grow per kelvin.

Coefficients near 20 degrees Celsius, 1/K. They turn a growth into kelvin, for people: nothing is
corrected by them. A tenth more or less is usual from one plate to the next (ISO 3650: 11.5 +- 1.0
for steel).

* steel: ISO 3650:1998, gauge blocks
* zerodur: SCHOTT, expansion class 1, of which this is the limit, with either sign
* cfrp: quasi-isotropic layup, Scientific Reports 14 (2024), 10.1038/s41598-024-65836-1, Table 2;
  other layups from 0 to 4
* all others: W. D. Callister, Materials Science and Engineering, 7th ed., Table B.6 (duralumin:
  2024, aluminium: 6061, titanium: Ti-6Al-4V, stainless steel: 304)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

EXPANSION: Final[Mapping[str, float]] = {
    "steel": 11.5e-6,
    "stainless steel": 17.2e-6,
    "cast iron": 11.4e-6,
    "aluminium": 23.6e-6,
    "duralumin": 22.9e-6,
    "titanium": 8.6e-6,
    "invar": 1.6e-6,
    "super invar": 0.72e-6,
    "alumina": 7.4e-6,
    "zirconia": 9.6e-6,
    "silicon carbide": 4.1e-6,
    "fused silica": 0.4e-6,
    "zerodur": 0.05e-6,
    "cfrp": 1.4e-6,
}
NOT_STATED: Final = ""
MATERIALS: Final = (NOT_STATED, *EXPANSION)
"""What ``material`` of a plate may be; of one that is not listed it is not stated."""


def kelvin(growth: float, material: str) -> float | None:
    """Return by how much a plate has warmed that grew by ``growth``; None: material not stated."""
    expansion = EXPANSION.get(material)
    return None if expansion is None else growth / expansion
