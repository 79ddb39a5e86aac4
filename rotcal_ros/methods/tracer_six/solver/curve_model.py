"""The lengths of several places as a model of the engine, to be solved with other instruments."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.carried_lengths import (
    CarriedLengths,
    KnownBeforehand,
    of_targets,
    slips_of,
    taken,
)
from rotcal_ros.methods.tracer_six.lengths.zeros import SLIPPED
from rotcal_ros.methods.tracer_six.solver.network import gauge_design
from rotcal_ros.methods.tracer_six.solver.scatter import roots_of
from rotcal_ros.methods.tracer_six.solver.solution import SixSolution


def curve_model(solution: SixSolution) -> CurveModel:
    """Return the lengths over the six deviations at the positions in use, about their solution.

    Scatter from arrival to arrival, and slips that would not be found, are errors in common.
    """
    problem, layout, grid = solution.problem, solution.layout, solution.grid
    curves, state = solution.table.curves, solution.network.state
    station, target, order = taken(grid.row, problem.measuring_order)
    row, std = grid.row[station, target], grid.length_std[station, target]
    zero = layout.zero[station, target]
    missed = 1.0 if solution.slips is None else 1.0 - solution.slips.found
    step = problem.slip * float(np.sqrt(SLIPPED / len(row) * missed))
    slips = slips_of(zero, order, step, float(std.min()))
    lengths = CarriedLengths(
        observed=grid.length[station, target],
        std=std,
        position=layout.position[station],
        place=layout.place[station],
        target=target,
        zero=zero,
        row=row,
        order=order,
        angles=layout.angles,
        places=(state.places - curves.table_origin) @ curves.table_turn,
        targets=grid.targets,
        zeros=state.zeros,
        axes=curves.axes,
        origin=curves.origin,
        common=np.hstack([slips, _scattered(solution)[station, target]]),
        tilts=True,
        unbroken=True,
    )
    named = {
        f"E{axis}C": lengths.rows_of(block, slice(k, None, 3))
        for block, axes in (("shift", "XYZ"), ("turn", "ABC"))
        for k, axis in enumerate(axes)
    }
    return lengths.model(
        named,
        [*of_targets(lengths, grid.target_std, grid.free), _tilts(lengths, layout.tilt_std)],
    )


def _scattered(solution: SixSolution) -> Floats:
    """Return what a unit of each station's scatter does to the lengths, (V, n, 3 V), m.

    Of the scatter that U holds, which is more than the likely one where few contrasts determine
    it.
    """
    unit, scatter = solution.network.slopes.unit, solution.scatter
    if scatter.translation == scatter.rotation == 0.0:
        return np.zeros((*unit.shape[:2], 0))
    arms = solution.network.state.arms(solution.layout)
    roots = roots_of(scatter.translation**2, scatter.rotation**2, arms)
    each, found = np.arange(len(unit)), np.zeros((*unit.shape[:2], len(unit), 3))
    found[each, :, each] = unit @ roots
    return found.reshape(*unit.shape[:2], -1)


def _tilts(lengths: CarriedLengths, std: float | None) -> KnownBeforehand:
    """Return what is stated of EAC and EBC, less how both frames lean."""
    m = 0 if std is None else len(lengths.angles)
    tilts = np.array([3 * j + axis for j in range(m) for axis in (0, 1)], dtype=np.int64)
    rows = lengths.rows_of("turn", tilts)
    lean = csr_array(gauge_design(lengths.angles[:m])[0]) @ lengths.rows_of("frame")
    return KnownBeforehand("the tilts", csr_array(rows - lean), np.full(2 * m, std or 1.0))
