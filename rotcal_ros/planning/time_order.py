"""The order in which observations were taken."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.observations import Observation


def time_order(observations: Sequence[Observation]) -> Ints:
    """Return the rank (k,) in time of each observation: by run, then by the end of its window.

    Observations without a time (plain tables) are in the order of the plan.
    """
    keys = (
        [o.step for o in observations],
        [o.window_end_ns for o in observations],
        [o.run for o in observations],
    )
    rank = np.empty(len(observations), dtype=np.int64)
    rank[np.lexsort(np.array(keys, dtype=np.int64))] = np.arange(len(observations))
    return rank
