"""The table that a controller holds, as its own rule applies it, and whether it acts.

With t the correction in force, c = -t is the deviation that it was made for. A table that acts
leaves nothing of it; one that does not act, or acts on another axis, leaves c; one with the wrong
sign adds c again and leaves 2 c; one that acts twice subtracts it twice and leaves -c. So the
regression factor of what is left on c shows which case it is; to add what is left to a table that
does not act as it should would be wrong in each of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.compensation.agreement import NO_MACHINE, MachineIdentity
from rotcal_ros.compensation.controller import Controller, Rule
from rotcal_ros.compensation.journal import contents_hash
from rotcal_ros.compensation.table import DIRECTIONS, CompensationTable
from rotcal_ros.compensation.writing import PROVENANCE, SCHEMA, without_provenance
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.curves.directional import directional_curve
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.gum_numbers import value_with_uncertainty
from rotcal_ros.foundation.in_force import NONE
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_ros.foundation.untrusted import load_json

ZERO_DEG: Final = "correction_at_reference_deg"
"""In a side file: the forward correction at the reference angle; without it none."""
RESIDUAL: Final = "residual_arcsec"
STATED: Final = "stated"
"""In a side file, within RESIDUAL: what the table leaves over."""


@dataclass(frozen=True, eq=False)
class HeldTable:
    """What a controller adds to its commands, exactly: the file's rows by the control's rule.

    ``in_force`` is the hash of the files. ``angles`` (n,), ``period`` and ``reference_angle``
    (rad) are as in a :class:`CompensationTable`; ``first`` (rad) is where the travel begins.
    ``machine`` is the machine it was made for. ``zero`` (rad) is the forward correction that it
    has at the reference angle on purpose: what the control did there without a table. ``stated``
    (rad) is what the table leaves over by its own account; 0: its side file does not say.
    """

    in_force: str
    rule: Rule
    angles: Floats
    period: float
    reference_angle: float
    first: float
    machine: MachineIdentity = NO_MACHINE
    zero: float = 0.0
    stated: float = 0.0

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


def hash_in_force(files: Mapping[str, str]) -> str:
    """Return the SHA-256 of a controller's own ``files``, without side files; "none" for none."""
    tables = without_provenance(files)
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
        zero = float(known.get(ZERO_DEG, 0.0)) * DEGREE
        stated = float(known.get(RESIDUAL, {STATED: 0.0})[STATED]) * ARCSEC
    except (ValueError, TypeError, KeyError) as error:
        raise DataError(
            "the rows of the table in force are not known: its side file "
            f"(*{PROVENANCE}) is missing, damaged or of another schema; measure without a "
            "table and replace it"
        ) from error
    try:
        rule = controller.read(without_provenance(files))
    except BagError as error:
        raise BagError(f"{error}; restore the file, or measure without a table") from error
    return HeldTable(
        in_force=hash_in_force(files),
        rule=rule,
        angles=angles,
        period=period,
        reference_angle=reference,
        first=controller.travel[0] if period else 0.0,
        machine=machine_from_files(files),
        zero=zero,
        stated=stated,
    )


def machine_from_files(files: Mapping[str, str]) -> MachineIdentity:
    """Return the machine that ``files`` were made for, by the side file among them."""
    try:
        side = load_json(_side(files))
        axis, serial = (side.get(name, "") for name in ("axis", "serial"))
    except (ValueError, TypeError, AttributeError):
        return MachineIdentity()
    return MachineIdentity(*(text if isinstance(text, str) else "" for text in (axis, serial)))


def _side(files: Mapping[str, str]) -> str:
    return next((text for name, text in files.items() if name.endswith(PROVENANCE)), "")


WRONG: Final = ((-1.5, -0.75), (0.75, 1.5), (1.5, 2.5))
"""Factors of a table that acts twice, does not act, or acts with the wrong sign. A larger factor
belongs to a table that corrects only a small part; adding to it is right."""
CAUSES: Final = (
    "it acts twice (at two places of the control, or in the control and in software)",
    "it is inactive, or on the wrong axis: check whether the control has loaded it (restart, "
    "reference run, its switch), and for this axis",
    "its sign is wrong: the control adds what it should subtract",
)
SURE: Final = 0.5
"""The factor, reduced by two standard uncertainties, must differ from 0 by at least this."""
SHARE: Final = 0.8
"""Least share of the variance of what is left, beyond noise, that the factor explains; less is
chance."""


@dataclass(frozen=True)
class CorrectionEffect:
    """How much is left of what the table in force corrects: 0 for one that acts.

    ``factor`` is the regression factor, ``std`` its standard uncertainty (k = 1), ``share`` of the
    variance of what is left is explained by it.
    """

    factor: float
    std: float
    share: float

    @property
    def fault(self) -> str | None:
        """The fault of the table in force, in words, if it is certain."""
        sure = abs(self.factor) - COVERAGE_FACTOR * self.std > SURE and self.share >= SHARE
        for (low, high), cause in zip(WRONG, CAUSES, strict=True):
            if sure and low <= self.factor < high:
                return phrase(
                    "the table in force does not act as it should: {0}; {1}", phrase(cause),
                    self.describe()
                )  # fmt: skip
        return None

    def describe(self) -> str:
        """Return the factor with its expanded uncertainty."""
        factor = value_with_uncertainty(self.factor, COVERAGE_FACTOR * self.std)
        return phrase(
            "{0} (k = {1:g}) times what it corrects is left (0: it acts; 1: it does not; 2: its "
            "sign is wrong)", factor, COVERAGE_FACTOR
        )  # fmt: skip


def regress_on_correction(
    left: Floats, corrected: Floats, covariance: Floats
) -> CorrectionEffect | None:
    """Return the regression factor of ``left`` (n,) on the ``corrected`` deviations (n,), rad.

    ``covariance`` (n, n), rad^2, is that of ``left``; both may count from any zero. None for a
    table that corrects nothing, or fewer than three values.
    """
    shape = corrected - np.mean(corrected)
    size = float(shape @ shape)
    if len(left) < 3 or size <= 0.0:
        return None
    weights = shape / size
    factor = float(weights @ left)
    free = left - np.mean(left)
    centre = np.eye(len(left)) - 1.0 / len(left)
    noise = float(np.sum(centre * covariance))
    signal = float(free @ free) - noise
    rest = free - factor * shape
    unexplained = max(float(rest @ rest) - noise, 0.0)
    share = 1.0 - unexplained / signal if signal > 0.0 else 0.0
    variance = float(weights @ covariance @ weights)
    return CorrectionEffect(factor, float(np.sqrt(max(variance, 0.0))), share)


def effect_from_result(result: Result, held: HeldTable) -> CorrectionEffect | None:
    """Return the effect of ``held`` by the ECC of ``result``, which was measured on top of it.

    It uses the joint covariance of both directions, if known.
    """
    curve = directional_curve(result)
    ways = DIRECTIONS if curve.both else DIRECTIONS[:1]
    left = np.concatenate([curve.forward, curve.reverse][: len(ways)])
    corrected = np.concatenate([-held.correction(curve.angles, way) for way in ways])
    return regress_on_correction(left, corrected, curve.covariance[: len(left), : len(left)])


def effect_from_table(table: CompensationTable, held: HeldTable) -> CorrectionEffect | None:
    """Return the effect of ``held`` by ``table``, which was measured on top of it.

    A table has a standard uncertainty for each value but no correlations: the one of the factor is
    the bound that holds for any.
    """
    ways = DIRECTIONS if table.directional else DIRECTIONS[:1]
    columns = (table.correction_forward, table.correction_reverse)
    left = np.concatenate([-column for column, _ in zip(columns, ways, strict=False)])
    corrected = np.concatenate([-held.correction(table.angles, way) for way in ways])
    std = np.concatenate([table.std_of(way) for way in ways])
    worst = std * np.sign(corrected - np.mean(corrected))
    return regress_on_correction(left, corrected, np.outer(worst, worst))
