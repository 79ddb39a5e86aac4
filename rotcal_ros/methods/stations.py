"""Where the instruments of a plan stand, as far as it is known before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.planning.plan import Point


@dataclass(frozen=True, slots=True)
class Stations:
    """Nominal places (m) of an instrument, by the number of the station; empty: not known.

    ``carried``: it rides on the table, and the places are those at angle 0 in the table frame.
    Otherwise it stands still, in the machine frame.
    """

    places: tuple[Point, ...] = ()
    carried: bool = False
