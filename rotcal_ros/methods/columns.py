"""Columns of numbers as a problem takes them: checked for shape, kind and range.

Raises DataError that names the column and the first bad row.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import DataError


def vector(name: str, values: ArrayLike, size: int | None = None) -> Floats:
    """Return ``values`` as a vector of finite numbers, of ``size`` if one is given."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or (size is not None and len(array) != size):
        expected = "one dimension" if size is None else f"shape ({size},), one value per row"
        raise DataError(f"{name} has shape {array.shape}, expected {expected}")
    return require(np.isfinite(array), array, name, "a finite number")


def matrix(name: str, values: ArrayLike) -> Floats:
    """Return ``values`` as finite numbers (n, 3)."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise DataError(f"{name} has shape {array.shape}, expected (n, 3)")
    return require(np.isfinite(array), array, name, "a finite number")


def broadcast(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return finite ``values``, one number or an array of that ``shape``, in that shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), shape):
        raise DataError(f"{name} has shape {array.shape}, expected one number or {shape}")
    return require(np.isfinite(array), np.full(shape, array), name, "a finite number")


def indices(name: str, values: ArrayLike, limit: int, size: int | None = None) -> NDArray[Any]:
    """Return ``values`` as whole numbers from 0 to below ``limit``."""
    array = np.asarray(values)
    if array.size == 0:
        raise DataError("there are no lengths: no observation was accepted")
    if (
        array.ndim != 1
        or array.dtype.kind not in "iu"
        or (size is not None and len(array) != size)
    ):
        raise DataError(
            f"{name} is {array.dtype} of shape {array.shape}, expected whole numbers, one per row"
        )
    inside = (array >= 0) & (array < limit)
    return require(inside, array.astype(np.int64), f"{name} index", f"0 to {limit - 1}")


def require(good: Bools, array: NDArray[Any], name: str, what: str) -> NDArray[Any]:
    """Return ``array`` where all is ``good``; else raise DataError naming the first bad entry."""
    good = np.broadcast_to(good, array.shape)
    if not good.all():
        place = tuple(int(i) for i in np.argwhere(~good)[0])
        row = place[0] if len(place) == 1 else place
        raise DataError(f"{name} in row {row} is {array[place]}, expected {what}")
    return array
