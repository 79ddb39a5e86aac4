"""The compensation table that waits at the bridge, and its confirmation by a person."""

from __future__ import annotations

import time
from math import ceil
from typing import Any, Final

import numpy as np
from rotcal_msgs.msg import CompensationTable as CompensationTableMsg
from rotcal_msgs.srv import ApplyTable, GetCorrection

from rotcal_ros.extensions.page.app import Answer
from rotcal_ros.extensions.page.state import ShownOffer
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.nodes.bridge.node import NEVER, OFFERED, WITHHELD
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import LATCHED

BRIDGE: Final = "bridge"
MOST_ANGLES: Final = 120
SILENCE_S: Final = 10.0
"""After this long without an answer the bridge is asked for the drawing again."""
UNDRAWN: Final = "it is not drawn yet"


class WaitingTable:
    """Follows the bridge; ``offer`` is None while no table has come to it.

    What the controller would add is asked of the bridge itself, so that the drawing shows what
    will be applied. Without the drawing nothing can be confirmed.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        self._table: Any = None
        self._asked_for = self._drawn_for = self._applied = ""
        self._attempt: object = None
        self._heard_s = 0.0
        self._drawing: dict[str, tuple[float, ...]] = {}
        node.listen(CompensationTableMsg, "compensation_table", self._take, LATCHED)
        self._look_up = node.create_client(GetCorrection, "get_correction")
        self._apply = node.create_client(ApplyTable, "apply")

    def offer(self) -> ShownOffer | None:
        """Return the present offer of the bridge."""
        health = self._node.health
        values = health.values(BRIDGE) if BRIDGE in health.present() else {}
        if "table_hash" not in values:
            return None
        confirmation, why_not = values.get("confirmation", ""), ""
        if OFFERED not in values:
            withheld = values.get(WITHHELD)
            why_not = f"not offered: {withheld}" if withheld else "the bridge does not offer it"
        if not confirmation:
            why_not = health.in_words(BRIDGE)
        elif never := values.get(NEVER):
            why_not = never
        elif self._drawn_for != confirmation:
            why_not = why_not or UNDRAWN
            self._see_to_the_drawing(confirmation, values["table_hash"])
        return ShownOffer(
            confirmation=confirmation,
            table_hash=values["table_hash"],
            verdict=values.get("verdict", ""),
            in_force=values.get("in_force", ""),
            residual=values.get("residual", ""),
            bridge=health.in_words(BRIDGE),
            why_not=why_not,
            applied=bool(confirmation) and confirmation == self._applied,
            simulated=self._table is not None
            and self._table.table_hash == values["table_hash"]
            and bool(self._table.simulated),
            **(self._drawing if confirmation == self._drawn_for else {}),
        )

    async def apply(self, confirmation: str, secret: str) -> Answer:
        """Have the bridge feed the table with this hash to the controller."""
        if not self._apply.service_is_ready():
            return Answer(False, "the bridge does not offer to apply a table")
        request = ApplyTable.Request(confirmation=confirmation, secret=secret)
        answer = await self._apply.call_async(request)
        if answer.success:
            self._applied = confirmation
        return Answer(answer.success, answer.message)

    def _take(self, message: Any) -> None:
        self._table = message

    def _see_to_the_drawing(self, confirmation: str, table_hash: str) -> None:
        """Ask for the drawing, again if an answer was lost."""
        silent = time.monotonic() - self._heard_s > SILENCE_S
        if (silent or self._asked_for != confirmation) and self._can_draw(table_hash):
            self._asked_for, self._attempt = confirmation, object()
            self._heard_s = time.monotonic()
            self._node.begin(self._draw, confirmation, self._table, self._attempt)

    def _can_draw(self, table_hash: str) -> bool:
        """Return whether the table of the bridge has arrived here too, and the bridge answers."""
        known = self._table is not None and self._table.table_hash == table_hash
        return known and bool(self._look_up.service_is_ready())

    async def _draw(self, confirmation: str, table: Any, attempt: object) -> None:
        """Draw the correction at the rows.

        The measured deviations are what the previous one left.
        """
        every = max(1, ceil(len(table.angles) / MOST_ANGLES))
        angles = np.array(table.angles[::every])
        drawing = {"angles_deg": _rounded(angles / DEGREE)}
        columns = {Approach.POSITIVE: ("", table.correction_forward),
                   Approach.NEGATIVE: ("_reverse", table.correction_reverse)}  # fmt: skip
        for side, (suffix, measured) in columns.items():
            answers = await self._ask(angles, side, attempt)
            if answers is None:
                return
            after = np.array([a.correction for a in answers])
            std = np.array([a.std for a in answers])
            # What the table in force adds already is what this one adds less what was measured.
            drawing[f"before{suffix}_arcsec"] = _rounded((after - measured[::every]) / ARCSEC)
            drawing[f"after{suffix}_arcsec"] = _rounded(after / ARCSEC)
            drawing[f"expanded{suffix}_arcsec"] = _rounded(COVERAGE_FACTOR * std / ARCSEC)
        self._drawn_for, self._drawing = confirmation, drawing

    async def _ask(self, angles: Floats, side: Approach, attempt: object) -> list[Any] | None:
        """Return the bridge's answers; None when one fails, or another attempt has begun.

        One after the other: a service holds ten requests and drops the rest.
        """
        answers = []
        for angle in angles:
            request = GetCorrection.Request(angle=float(angle), approach=int(side))
            answers.append(await self._look_up.call_async(request))
            if attempt is not self._attempt or not answers[-1].success:
                return None
            self._heard_s = time.monotonic()
        return answers


def _rounded(values: Any) -> tuple[float, ...]:
    return tuple(round(float(v), 4) for v in values)
