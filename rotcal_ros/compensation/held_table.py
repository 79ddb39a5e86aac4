"""The table that a controller holds, from its own files, as its own rule applies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotcal_ros.compensation.agreement import NO_MACHINE, MachineIdentity
from rotcal_ros.compensation.controller import Controller, Rule
from rotcal_ros.compensation.journal import contents_hash
from rotcal_ros.compensation.writing import PROVENANCE, SCHEMA, of_the_controller
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.interpolation import TURN
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import NONE
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.foundation.untrusted import load_json


@dataclass(frozen=True, eq=False)
class HeldTable:
    """What a controller adds to its commands, exactly: the file's rows by the control's rule.

    ``in_force`` is the hash of the files. ``angles`` (n,), ``period`` and ``reference_angle``
    (rad) are as in a :class:`CompensationTable`; ``first`` (rad) is where the travel begins.
    ``machine`` is the machine it was made for.
    """

    in_force: str
    rule: Rule
    angles: Floats
    period: float
    reference_angle: float
    first: float
    machine: MachineIdentity = NO_MACHINE

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the correction (rad) at ``angle`` (rad), for a circle in the first turn."""
        if self.period:
            angle = self.first + np.mod(angle, self.period)
        return self.rule.correction(angle, approach)

    def slope(self, angle: Floats, approach: Approach) -> Floats:
        """Return the derivative of the correction, over a thousandth of the widest gap."""
        half = 0.5e-3 * float(np.max(np.diff(self.angles)))
        ends = (self.correction(angle + x, approach) for x in (half, -half))
        return np.subtract(*ends) / (2.0 * half)


def in_force_of(files: Mapping[str, str]) -> str:
    """Return the SHA-256 of a controller's own ``files``, without side files; "none" for none."""
    tables = of_the_controller(files)
    return contents_hash(tables) if tables else NONE


def held_table(controller: Controller, files: Mapping[str, str]) -> HeldTable:
    """Return the table in ``files``, which hold its side file too.

    Raises DataError when the angles of the rows are missing, BagError for damaged files.
    """
    try:
        known = load_json(_side(files))
        if known["schema"] != SCHEMA:
            raise ValueError(f"its schema is {known['schema']!r:.20}, expected {SCHEMA}")
        angles = np.array(known["row_angles_deg"], dtype=np.float64) * DEGREE
        period = TURN if known["closed"] else 0.0
        reference = float(known["reference_angle_deg"]) * DEGREE
    except (ValueError, TypeError, KeyError) as error:
        raise DataError(
            "the rows of the table in force are not known: its side file "
            f"(*{PROVENANCE}) is missing, damaged or of another schema; measure without a "
            "table and replace it"
        ) from error
    return HeldTable(
        in_force=in_force_of(files),
        rule=controller.read(of_the_controller(files)),
        angles=angles,
        period=period,
        reference_angle=reference,
        first=controller.travel[0] if period else 0.0,
        machine=machine_of(files),
    )


def machine_of(files: Mapping[str, str]) -> MachineIdentity:
    """Return the machine that ``files`` were made for, by the side file among them."""
    try:
        side = load_json(_side(files))
        axis, serial = (side.get(name, "") for name in ("axis", "serial"))
    except (ValueError, TypeError, AttributeError):
        return MachineIdentity()
    return MachineIdentity(*(text if isinstance(text, str) else "" for text in (axis, serial)))


def _side(files: Mapping[str, str]) -> str:
    return next((text for name, text in files.items() if name.endswith(PROVENANCE)), "")
