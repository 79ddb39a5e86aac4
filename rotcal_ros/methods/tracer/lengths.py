"""Observed lengths as arrays: where the reflector was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation


def reported_positions(observations: Sequence[Observation]) -> Floats:
    """Return where the machine says the probe was, shape (k, 3)."""
    return np.array([o.probe_position for o in observations]).reshape(-1, 3)


def mean_targets(nominal: Floats, target: Ints, reported: Floats) -> Floats:
    """Return the mean reported position of each target, shape (n, 3)."""
    count = np.bincount(target, minlength=len(nominal))
    total = np.zeros_like(nominal)
    np.add.at(total, target, reported)
    seen = count > 0
    total[seen] /= count[seen, None]
    total[~seen] = nominal[~seen]
    return total
