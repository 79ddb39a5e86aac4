"""Which run of a plan a file of a bag belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from rotcal_ros.bags import names

_DIGITS: Final = 9
"""A number with more of them is none that a recorder wrote."""


def run_number(metadata: Mapping[str, Mapping[str, str]], unknown: int = 0) -> int:
    """Return the number of the run in the metadata of a file; ``unknown`` where it says none."""
    number = metadata.get(names.RUN, {}).get("number", "")
    is_one = number.isascii() and number.isdecimal() and len(number) <= _DIGITS
    return int(number) if is_one else unknown
