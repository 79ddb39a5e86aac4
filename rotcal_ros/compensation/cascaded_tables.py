"""A table on top of another: both corrections as one, and the combinations that make sense.

A measurement made while a table is in force shows what this table leaves over. The control with
its table is then the axis that was measured: a further correction n(x) moves the command from x to
x + n(x), and there the table in force adds its own, t(x + n(x)). So the sum is n(x) + t(x + n(x)):
the further one at the command, the one in force at the corrected command.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from rotcal_ros.compensation.held_table import HeldTable, effect_from_table
from rotcal_ros.compensation.interpolation_uncertainty import interpolation_std
from rotcal_ros.compensation.table import (
    DIRECTIONS,
    CompensationTable,
    Correction,
    check_verdict,
    resample,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.directional import DirectionalCurve
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, interpolation_matrix
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import NONE, UNKNOWN, describe, is_table_hash
from rotcal_ros.foundation.units import ARCSEC

Combination = Literal["as_measured", "replace", "add"]
"""What a person says of a table: nothing, that it is the whole correction, or that it is what the
one in force left."""
NEAR: Final = 0.25
"""Rows of the table in force that are nearer to a measured angle than this part of its widest gap
are left out: noise would bend the curve between rows so close together."""


def combine_with_table_in_force(
    table: CompensationTable,
    in_force: Callable[[], HeldTable | None],
    word: Combination = "as_measured",
) -> CompensationTable:
    """Return the table that a controller gets for ``table``, which was measured.

    ``in_force`` returns the table that it may be added to, None where there is none. A table that
    was measured with none in force replaces; one that was measured on top of another is added to
    that very one, unless the measurement shows that the one in force does not act as it should
    (:mod:`.held_table`). Where it is not known what was in force, the ``word`` of a person
    decides. Raises DataError, with the reason, for every other combination.
    """
    if table.open_zeros:
        check_verdict(table)
    _refuse_word(table, word)
    if table.measured_on == UNKNOWN:
        note = f"'{word}' is the word of a person: {describe(UNKNOWN)}"
        table = replace(table, warnings=(*table.warnings, note))
    if table.measured_on == NONE or word == "replace":
        return table
    held = in_force()
    if held is None:
        raise DataError(
            f"there is no table to add to: {describe(table.measured_on)}; name it (rotcal export "
            "--add-to), or restore it"
        )
    if is_table_hash(table.measured_on) and held.in_force != table.measured_on:
        raise DataError(
            f"not added: {describe(table.measured_on)}, and the one to add to is "
            f"{held.in_force[:12]}; measure again with what the controller holds now"
        )
    acts = effect_from_table(table, held)
    if acts is not None and acts.fault:
        raise DataError(
            f"not added: {acts.fault}. Correct that and measure again, or remove the table "
            "(restore), measure without one and replace it"
        )
    return add_tables(table, held)


def _refuse_word(table: CompensationTable, word: Combination) -> None:
    """Raise DataError if the ``word`` does not fit what is known, or is missing."""
    if table.adds_to:
        raise DataError(
            f"the table contains the table {table.adds_to[:12]} already: feed it as it is"
        )
    if table.measured_on == UNKNOWN and word == "as_measured":
        raise DataError(
            f"{describe(UNKNOWN)}. Say which: 'replace' if there was none, 'add' if it was the "
            "one that the controller holds now (rotcal export --replace, --add-to; "
            "rc.write_controller_files replaces, add_to; bridge.combine); before measuring: "
            "cell.table_in_force"
        )
    if table.measured_on == NONE and word == "add":
        raise DataError(f"not added: {describe(NONE)}; let it replace the table in force")
    if is_table_hash(table.measured_on) and word == "replace":
        raise DataError(
            f"not replaced: {describe(table.measured_on)}, and replacing that table would lose "
            "what it corrects; add to it"
        )


def add_tables(table: CompensationTable, held: HeldTable) -> CompensationTable:
    """Return the corrections of ``table``, measured on top of ``held``, and of ``held`` in one.

    At the reference angle of ``held`` the sum is what that is there. The numbers in a controller
    are known exactly, so the uncertainty is that of ``table``, times the slope 1 + t'. It has a
    row at every angle that was measured and at the rows of ``held`` between them. Raises DataError
    when one of them covers the full circle and the other an arc, or an arc does not cover the
    rows.
    """
    if table.closed != (held.period > 0.0):
        whole, part = ("table", "one in force") if table.closed else ("one in force", "table")
        raise DataError(
            f"not added: the {whole} covers the full circle and the {part} only an arc: measure "
            "what the table in force covers"
        )
    new = _with_zero(table, held.reference_angle)
    rows = _rows(new, held)
    further = Correction(new)
    own = [further(rows, approach) for approach in DIRECTIONS]
    both = [
        o + held.correction(rows + o, approach)
        for o, approach in zip(own, DIRECTIONS, strict=True)
    ]
    moved = held.correction(np.array([held.reference_angle]), DIRECTIONS[0])[0] - held.zero
    std = [
        further.std(rows, approach) * (1.0 + held.slope(rows + o, approach))
        for o, approach in zip(own, DIRECTIONS, strict=True)
    ]
    largest = max(float(np.max(np.abs(o))) for o in own) / ARCSEC
    note = (
        f"adds to the table {held.in_force[:12]} in force: up to {largest:.3g} arcsec on top of it"
    )
    total = replace(
        new,
        angles=rows,
        correction_forward=both[0] - moved,
        correction_reverse=both[1] - moved,
        zero=held.zero,
        std=std[0],
        std_reverse=std[1],
        measured_on=held.in_force,
        adds_to=held.in_force,
        serial=table.serial or held.machine.serial,
        warnings=(*table.warnings, note),
    )
    return replace(total, between_std=float(np.hypot(new.between_std, _between(total))))


def _with_zero(table: CompensationTable, reference: float) -> CompensationTable:
    if abs(table.reference_angle - reference) < SAME_ANGLE:
        return table
    return resample(table, reference_angle=reference)


def _rows(table: CompensationTable, held: HeldTable) -> Floats:
    """Return the angles of ``table``, and those of ``held`` that are not near any of them."""
    apart = np.abs(held.angles[:, None] - table.angles[None, :])
    if table.closed:
        apart = np.minimum(apart, table.period - apart)
    near = NEAR * float(np.max(np.diff(held.angles)))
    rows = np.concatenate([table.angles, held.angles[np.min(apart, axis=1) > near]])
    return np.sort(rows)


def _between(table: CompensationTable) -> float:
    """Return what the whole correction may do between its rows, as :func:`interpolation_std`."""
    stds = np.concatenate([table.std_of(approach) for approach in DIRECTIONS])
    curve = DirectionalCurve(
        angles=table.angles,
        forward=-table.correction_forward,
        reverse=-table.correction_reverse,
        covariance=np.diag(stds**2),
        period=table.period,
        both=table.directional,
    )

    def weights(of: DirectionalCurve, at: Floats) -> Floats:
        return interpolation_matrix(of.angles, at, of.period)

    return float(np.max(interpolation_std(curve, weights, table.reference_angle)))
