"""Bringing angle readings with unknown zeros together: one deviation per table position.

Every reading is deviation(position) + zero(set) + error. A set is what shares a zero: a tracker
station in stitching, a reflector in the direct way, everything in registration. Neighbouring sets
are tied by the positions they share. With one shared position from set to set, the least
squares below are the paper's running sum (equations 7 to 16); with more, all ties are used.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.arrays import Floats, Ints


def joining_map(position: Ints, zero: Ints, variance: Floats, n: int) -> Floats:
    """Return the matrix (n, m) from readings (m,) to deviations from the first position.

    ``position``, ``zero`` (m,) say where each reading belongs, ``variance`` (m,) its weight.
    All n positions and all sets must be tied together: see :func:`islands`.
    """
    m = len(position)
    design = np.zeros((m, n + zero.max() + 1))
    design[np.arange(m), position] = 1.0
    design[np.arange(m), n + zero] = 1.0
    root = 1.0 / np.sqrt(variance / variance.mean())
    solution = np.linalg.pinv(design[:, 1:] * root[:, None]) * root
    return np.vstack([np.zeros(m), solution[: n - 1]])


def islands(position: Ints, zero: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the island number of each position (n,) and of each set; one island is good."""
    sets = int(zero.max()) + 1
    links = coo_array((np.ones(len(position)), (position, n + zero)), shape=(n + sets, n + sets))
    _, label = connected_components(links, directed=False)
    return label[:n].astype(np.int64), label[n:].astype(np.int64)
