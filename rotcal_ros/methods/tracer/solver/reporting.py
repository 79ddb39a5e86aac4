"""What results of lengths say, however many places they were taken from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Rejection, Result
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths
from rotcal_ros.methods.tracer.solver.problem import Grid, LengthProblem

COMES_BACK_WITHIN: Final = noted(
    "what of it does not come back with the angle is less than {0:.2g} um, {1:.2g} arcsec (95 %, "
    "{2})"
)
NO_ANGLE_AGAIN: Final = noted(
    "no angle was measured again, which would bound what of it does not come back with {0}"
)
ALONG_ITS_CIRCLE: Final = noted(
    "a tracer that mount or cable shift along its circle between the angles{0} leaves no trace "
    "in any length: 1 um of it is {1:.2f} arcsec{2}"
)


def expand_to_all_rows(
    result: Result, problem: LengthProblem, lengths: CarriedLengths, absent: dict[int, Phrase]
) -> Result:
    """Return the ``result`` of ``lengths`` as one of all rows of their ``problem``.

    ``absent``: why rows are not among them; NaN is their residual.
    """
    row, count, found = lengths.row, len(problem.length), result.residuals
    assert found is not None

    def every(values: Floats, otherwise: Floats | float) -> Floats:
        column = np.full(count, otherwise, dtype=np.float64)
        column[row] = values
        return column

    gone = absent | {int(row[r.index]): r.why for r in result.rejected}
    return replace(
        result,
        n_observations=count,
        rejected=tuple(Rejection(*each) for each in sorted(gone.items())),
        raw_data=result.raw_data.with_row_numbers(dict(enumerate(row.tolist()))),
        residuals=replace(
            found,
            table_position=problem.position,
            target=problem.target,
            residual=every(found.residual, np.nan),
            redundancy=every(found.redundancy, 0.0),
            test_value=every(found.test_value, 0.0),
            used=every(found.used.astype(np.float64), 0.0).astype(np.bool_),
            std=None if found.std is None else every(found.std, problem.length_std),
        ),
    )


def target_corrections(found: Adjusted, lengths: CarriedLengths) -> dict[str, Floats]:
    """Return by what the targets were corrected, (n, 3), m, and how well that is known."""
    fit = found.fit
    rows = np.eye(lengths.blocks["target"], len(fit.x), lengths.first["target"])
    if lengths.target_ways is not None:
        rows = lengths.target_ways @ rows
    std = found.scale * np.sqrt(np.maximum(fit.kernel.variances(rows), 0.0))
    moved = lengths.part(fit.x, "target")
    return {"target_corrections": moved, "target_corrections_std": std.reshape(-1, 3)}


def segment_details(
    found: Adjusted, lengths: CarriedLengths, grid: Grid, place_ids: Ints | None = None
) -> list[dict[str, Any]]:
    """Return one entry per unbroken beam, in the order of time.

    ``zero``, ``std``: range at reading zero where it begins, m. ``step``, ``step_std``: the zero
    less that at the end of the one before from the same place, as stations and targets that both
    have measured show it, m; ``probability``: how likely it would be if the zero had stayed.
    ``place_ids``: numbers of the places, where there are several.
    """
    fit, count = found.fit, lengths.blocks["zero"]
    rows = np.eye(count, len(fit.x), lengths.first["zero"])
    covariance = found.scale**2 * (rows @ fit.kernel.times(rows.T))
    zeros = lengths.zeros + lengths.part(fit.x, "zero")
    beam = lengths.zero if lengths.beam is None else lengths.beam
    in_time = np.lexsort((lengths.order, beam))
    last = np.append(np.flatnonzero(np.diff(beam[in_time])), len(in_time) - 1)
    first, last = in_time[np.append(0, last[:-1] + 1)], in_time[last]
    assert grid.segment_ids is not None
    entries, before = [], dict[int, int]()
    for k in np.argsort(lengths.order[first], kind="stable").tolist():
        begins, place = int(first[k]), int(lengths.place[first[k]])
        zero = int(lengths.zero[begins])
        entry: dict[str, Any] = {"segment": int(grid.segment_ids[beam[begins]])}
        if place_ids is not None:
            entry["place_id"] = int(place_ids[place])
        entry |= {
            "lengths": int(fit.used[: len(beam)][beam == beam[begins]].sum()),
            "zero": float(zeros[zero]),
            "std": float(np.sqrt(covariance[zero, zero])),
        }
        if (at_end := before.get(place)) is not None:
            step = float(zeros[zero] - zeros[at_end])
            (a, b), (_, c) = covariance[np.ix_([at_end, zero], [at_end, zero])].tolist()
            variance = a + c - 2.0 * b
            entry |= {
                "step": step, "step_std": float(np.sqrt(variance)),
                "probability": chi2_sf(step**2 / variance, 1.0),
            }  # fmt: skip
        entries.append(entry)
        before[place] = int(lengths.zero[last[k]])
    return entries


def tangential_protection(
    radius: float,
    *,
    alike: str,
    of: str = "",
    beside: str = "",
    within: float | None,
    shown: str,
    untested: str,
) -> Protection:
    """Return the statement about a tracer that moves along its circle between the angles.

    All its lengths are those of a table that turned further: none can show it, and an angle that
    was measured again bounds only what does not come back with the angle. ``radius`` (m) of the
    circle; ``alike``: what else looks like it, ``of`` which deviation the angle is, ``beside``:
    what else is said. ``within`` (m): how near the tracer came back, 95 %, as ``shown``; None:
    that is ``untested``.
    """
    why = phrase(ALONG_ITS_CIRCLE, alike, MICROMETRE / radius / ARCSEC, of)
    bound = phrase(NO_ANGLE_AGAIN, untested)
    if within is not None:
        bound = phrase(COMES_BACK_WITHIN, within / MICROMETRE, within / radius / ARCSEC, shown)
    every = join_texts([text for text in (why, beside, bound) if text])
    return Protection("tangential motion", "not protected", every)
