"""What a statement that is exceeded does to the result until the verdict changes.

The uncertainty holds what is stated of motions, linear axes, tip and bar. Whether that is true is
another matter: of a motion in one order a ball shows a part, which may be small by chance, and the
rest passes for an axis that stands elsewhere. What stays unseen follows from the solution alone,
not from what was read.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.adjust.effects import UNSEEN, Unseen
from rotcal_ros.adjust.engine import LIMITS, Adjusted
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.table_balls.model import BallsOnTable
from rotcal_ros.methods.table_balls.motions import MOTION_KINDS, stated_motions_of

EXCEEDED: Final = 5.0
"""Times as large as stated that something may be without striking anybody."""


def exceeded(balls: BallsOnTable, found: Adjusted) -> dict[str, Unseen]:
    """Return what may stay unseen of each kind of motion that is stated, and of each other block.

    A motion is found by what the balls show of it, see
    :meth:`~.motions.StatedMotions.contradictions`, all else by chi-squared; where motions are
    stated too, they explain whatever that would find.
    """
    fit, model, outputs = found.fit, found.model, len(found.value)
    std = found.counting_std[:outputs]
    counts, last = std > 0.0, len(model.components) - 1
    row, worst = int(np.argmax(model.of_component == last)), dict[str, Unseen]()

    def share(rows: slice) -> Floats:
        return np.asarray(
            fit.alone(np.arange(rows.start, rows.stop))[:outputs][counts] / std[counts, None]
        )

    for together in stated_motions_of(model):
        every = slice(row, row + len(together.rows))
        felt, row = share(every), every.stop
        sizes = together.found_from(fit)
        for kind, roots, size in zip(MOTION_KINDS, together.parts, sizes, strict=True):
            moved = [np.linalg.norm(felt @ root, axis=1).max(initial=0.0) for root in roots]
            worst[kind] = Unseen.worst(size, np.array(moved), EXCEEDED)
    needed = noncentrality(LIMITS.significance, POWER, max(fit.dof, 1))
    for name in (name for name, std in balls.known.items() if isfinite(std)):
        block = slice(row, row + balls.blocks[name])
        left, row = fit.redundancy[block], block.stop
        checked = (left > UNSEEN) & (not model.correlated)
        size = np.where(checked, np.sqrt(needed / np.where(checked, left, 1.0)), np.inf)
        does = share(block)
        error = np.linalg.norm(np.minimum(size, EXCEEDED) * does, axis=1).max(initial=0.0)
        feels = np.abs(does).max(axis=0, initial=0.0) > UNSEEN
        worst[name] = Unseen(float(error), bool((size <= EXCEEDED)[feels].all()))
    return worst
