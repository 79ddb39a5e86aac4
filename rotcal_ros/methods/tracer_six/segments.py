"""What became of the zeros of unbroken beams: where they are, and their steps at one place."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.methods.tracer.segments import step_between
from rotcal_ros.methods.tracer_six.solution import SixSolution
from rotcal_ros.methods.tracer_six.timing import timing


def segment_report(solution: SixSolution) -> list[dict[str, Any]]:
    """Return one entry per segment, in the order of time; none where no segments are told.

    ``segment``: its number in the problem; ``place_id``: where the tracer stood; ``zero``,
    ``std``: range at reading zero, m. Behind another segment of the same place also ``step``,
    ``step_std``: the zero less that of the segment before, as the rigid table and all targets
    tell it, m; ``probability``: how likely it would be if the zero had stayed.
    """
    problem, layout, grid = solution.problem, solution.layout, solution.grid
    if problem.segment is None:
        return []
    used = grid.row >= 0
    when = np.where(used, timing(problem, grid).whole, np.inf)
    first = 3 * (len(grid.targets) + len(layout.places))
    zeros = slice(first, first + layout.n_zeros)
    covariance = solution.scale**2 * solution.fit.posterior.covariance[zeros, zeros]
    value = solution.zeros
    begun = [when[layout.zero == z].min() for z in range(layout.n_zeros)]
    found: list[dict[str, Any]] = []
    before: dict[int, int] = {}
    for z in np.argsort(begun, kind="stable").tolist():
        station, target = np.argwhere(used & (layout.zero == z))[0]
        place = int(layout.place[station])
        entry = {
            "segment": int(problem.segment[grid.row[station, target]]),
            "place_id": int(layout.place_ids[place]),
            "lengths": int(grid.used[layout.zero == z].sum()),
            "zero": float(value[z]),
            "std": float(np.sqrt(covariance[z, z])),
        }
        if place in before:
            entry |= step_between(value, covariance, before[place], z)
        found.append(entry)
        before[place] = z
    return found
