"""Factors between SI and the units that people read: value_in_unit = value_si / UNIT."""

from math import pi
from typing import Final

TURN: Final = 2.0 * pi
DEGREE: Final = pi / 180.0
ARCSEC: Final = DEGREE / 3600.0
MICRORADIAN: Final = 1e-6
MILLIMETRE: Final = 1e-3
MICROMETRE: Final = 1e-6
NANOSECOND: Final = 1e-9
MINUTE: Final = 60.0
HOUR: Final = 3600.0
