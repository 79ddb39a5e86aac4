"""The rotary table of a DME server: its angle R, and the call that turns it.

1.4 knows one way for every machine, AlignPart: a vector of the part is turned to a vector of the
machine (12.1). Later versions take R in a GoTo. Which side the table comes from, neither says:
that is done by two turns.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, radians, remainder, sin
from typing import Final

from rotcal_ros.dme.faults import DmeError
from rotcal_ros.dme.grammar import Call, call
from rotcal_ros.dme.settings import ALIGN_PART, AUTO, GOTO_R, DmeSettings
from rotcal_ros.observations import Approach
from rotcal_ros.table_motion import approached
from rotcal_ros.units import DEGREE

FIRST_WITH_R: Final = 2
"""Major version from which R is an ordinary argument of GoTo."""
FAR_OFF_DEG: Final = 1.0
"""A table that is farther from its order than this has understood it otherwise."""


def way_to_turn(setting: str, version: str) -> str:
    """Return how a server of this version wants its table to be turned.

    Raises DmeError when ``setting`` leaves it to a version that cannot be read.
    """
    if setting != AUTO:
        return setting
    found = re.match(r"\s*(\d+)(\.|$)", version)
    if found is None:
        raise DmeError(
            f"the server states its version as {version!r:.40}: set dme.turn_by to {GOTO_R} or "
            f"{ALIGN_PART}"
        )
    return GOTO_R if int(found[1]) >= FIRST_WITH_R else ALIGN_PART


@dataclass(frozen=True)
class TableAxis:
    """How angles of the table (rad, counter-clockwise about +z) become calls, and R angles."""

    settings: DmeSettings
    turn_by: str

    @property
    def _sign(self) -> float:
        return -1.0 if self.settings.table_reversed else 1.0

    def angle(self, r_deg: float, near: float) -> float:
        """Return the angle (rad) of the table at R, of all turns the one nearest to ``near``."""
        found = radians(self._sign * (r_deg - self.settings.table_zero_deg))
        return near + remainder(found - near, 2.0 * pi)

    def turn(self, angle: float) -> Call:
        """Return the call that turns the table to ``angle`` (rad)."""
        if self.turn_by == GOTO_R:
            r_deg = self.settings.table_zero_deg + self._sign * angle / DEGREE
            return call("GoTo", Call("R", (r_deg,)))
        turned = self._sign * angle + radians(self.settings.table_zero_deg)
        return call("AlignPart", 1.0, 0.0, 0.0, cos(turned), sin(turned), 0.0, 0.0)

    def stops(self, here: float, angle: float, approach: Approach) -> Sequence[float]:
        """Return the angles (rad) to go to, so that ``angle`` is reached from side ``approach``.

        AlignPart goes the shorter way round: none of its turns is longer than a third of a circle.
        """
        way = approached(here, angle, approach, self.settings.overshoot_deg * DEGREE)
        if self.turn_by == ALIGN_PART:
            return [*_in_thirds(here, way[0]), *way[1:]]
        return list(way)

    def check_arrival(self, angle: float, ordered: float) -> None:
        """Raise DmeError when the table is somewhere else than ordered (rad)."""
        off_deg = remainder(angle - ordered, 2.0 * pi) / DEGREE
        if abs(off_deg) > FAR_OFF_DEG:
            raise DmeError(
                f"the table was sent to {ordered / DEGREE:.3f} deg and stands {off_deg:+.3f} deg "
                f"from there: see dme.table_zero_deg, dme.table_reversed and dme.turn_by (now "
                f"{self.turn_by}), and that the part's coordinates are those of the table"
            )


def _in_thirds(here: float, angle: float) -> list[float]:
    """Return angles on the way that are at most a third of a circle apart."""
    count = int(abs(angle - here) // (2.0 * pi / 3.0)) + 1
    return [here + (angle - here) * part / count for part in range(1, count)] + [angle]
