"""Derivatives in whatever form a method hands over, as a :class:`~.kernels.Design`."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.bordered import Groups, SparseDesign
from rotcal_ros.adjust.kernels import DenseDesign, Design
from rotcal_ros.foundation.arrays import Floats

Derivatives: TypeAlias = "Floats | csr_array | Design"
"""Derivatives (n, p), whole or only those that may not be zero."""

FEW: Final = 120
"""Unknowns below which the whole of them is quicker."""


def make_design(found: Derivatives, groups: Groups | None = None) -> Design:
    """Return the design of derivatives; ``groups``: into which they fall, if they are those."""
    if isinstance(found, csr_array):
        if found.shape[1] < FEW:
            return DenseDesign(found.toarray())
        found = SparseDesign(found, np.zeros((0, found.shape[1])))
    if isinstance(found, SparseDesign):
        return replace(found, groups=groups)
    return found if isinstance(found, Design) else DenseDesign(np.asarray(found))


def dense(found: Derivatives) -> Floats:
    """Return derivatives as a whole matrix (n, p)."""
    return make_design(found).dense()
