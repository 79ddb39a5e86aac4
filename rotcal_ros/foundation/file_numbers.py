"""Numbers of a file as arrays, checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotcal_ros.foundation.arrays import Floats


def finite_columns(data: Any, where: str, shape: tuple[int, ...]) -> dict[str, Floats]:
    """Return the arrays of finite numbers by component at ``where`` in a file, of one ``shape``.

    ValueError for anything else.
    """
    columns = {name: floats(values, f"{where}.{name}") for name, values in dict(data).items()}
    for name, column in columns.items():
        if column.shape != shape or not np.all(np.isfinite(column)):
            raise ValueError(f"{where}.{name}: expected finite numbers of the shape {shape}")
    return columns


def finite_column(values: Any, where: str) -> Floats:
    """Return the list of finite numbers at ``where`` in a file; ValueError for anything else."""
    column = floats(values, where)
    if column.ndim != 1 or not np.all(np.isfinite(column)):
        raise ValueError(f"{where}: expected a list of finite numbers")
    return column


def floats(values: Any, where: str) -> Floats:
    """Return numbers as an array, null as NaN; ValueError for texts, which numpy would take."""
    try:
        found = np.asarray(values)
        if found.dtype.kind in "US":
            raise ValueError("it holds texts")
        numbers = found.astype(np.float64)
    except (ArithmeticError, TypeError, ValueError) as error:
        raise ValueError(f"{where}: not an array of numbers: {error}") from error
    if np.any(np.isinf(numbers)):
        raise ValueError(f"{where}: it holds infinite numbers")
    return numbers
