"""Numbers as people see them: two significant digits of U, the value to the same place.

The GUM requires this (JCGM 100:2008, 7.2.6). U is always an expanded uncertainty, with the
coverage factor of :mod:`~rotcal_ros.foundation.components`.
"""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal
from typing import Final

SIGNIFICANT_DIGITS: Final = 2
EXACT: Final = "0"
"""A value that is zero by definition, as a curve is at the angle it counts from."""


def last_digit_place(expanded: float) -> int:
    """Return the place of the last digit of ``expanded`` > 0: -2 is a hundredth, 1 is ten.

    >>> last_digit_place(0.0996), last_digit_place(0.0994), last_digit_place(1234.0)
    (-2, -3, 2)
    """
    place = _exact(expanded).adjusted() - SIGNIFICANT_DIGITS + 1
    # Rounding up may win a digit: 0.0996 becomes 0.10, not 0.100.
    return _rounded(expanded, place).adjusted() - SIGNIFICANT_DIGITS + 1


def uncertainty(expanded: float) -> str:
    """Return an expanded uncertainty with two significant digits; zero is exact.

    >>> uncertainty(0.8468), uncertainty(12.34), uncertainty(0.0)
    ('0.85', '12', '0')
    """
    return value_to_place(expanded, last_digit_place(expanded)) if expanded else EXACT


def value(number: float, expanded: float) -> str:
    """Return a number with its sign, to the place of its expanded uncertainty.

    >>> value(6.6, 0.8), value(-0.001, 0.8), value(0.0, 0.0)
    ('+6.60', '0.00', '0')
    """
    if not expanded:
        return EXACT if number == 0.0 else f"{number:+.6g}"
    return value_to_place(number, last_digit_place(expanded), sign=True)


def value_with_uncertainty(number: float, expanded: float) -> str:
    """Return both; a value that is zero by definition has no uncertainty.

    >>> value_with_uncertainty(6.6, 0.8), value_with_uncertainty(0.0, 0.0)
    ('+6.60 ± 0.80', '0')
    """
    if not expanded:
        return value(number, expanded)
    return f"{value(number, expanded)} ± {uncertainty(expanded)}"


def typeset_minus(number: str) -> str:
    """Return a number as typeset: with a minus sign instead of a hyphen."""
    return number.replace("-", "\N{MINUS SIGN}")


def value_to_place(number: float, place: int, *, sign: bool = False) -> str:
    """Return a number to a place of :func:`last_digit_place`, with its sign if ``sign`` is true.

    >>> value_to_place(3.14159, -2), value_to_place(1234.0, 2), value_to_place(5.0, -1, sign=True)
    ('3.14', '1200', '+5.0')
    """
    rounded = _rounded(number, place)
    if not rounded:
        return f"{abs(rounded):.{max(-place, 0)}f}"  # a zero has no sign
    return f"{rounded:{'+' * sign}.{max(-place, 0)}f}"


def _rounded(number: float, place: int) -> Decimal:
    return _exact(number).quantize(Decimal((0, (1,), place)), ROUND_HALF_UP)


def _exact(number: float) -> Decimal:
    """Return the shortest decimal for this number, so that halves round exactly."""
    return Decimal(repr(float(number)))
