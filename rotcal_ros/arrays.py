"""Types of arrays: what their elements are; docstrings say which shape they have."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Complexes: TypeAlias = NDArray[np.complex128]
Bytes: TypeAlias = NDArray[np.uint8]
Stamps: TypeAlias = NDArray[np.int64]
"""Times in integer nanoseconds."""
