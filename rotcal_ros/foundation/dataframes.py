"""DataFrames of what has a value for every angle. Only who asks for one needs pandas."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.errors import ConfigurationError

_NAMES: Final = {"angles": "angle_rad", "targets": "angle_rad"}


def dataframe(columns: Mapping[str, Any]) -> Any:
    """Return a pandas DataFrame of arrays (n,); without pandas, ImportError says so."""
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise ImportError("to_dataframe() needs pandas: pip install pandas") from error
    return pandas.DataFrame(columns)


def arrow() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet half; ConfigurationError where it is not installed."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise ConfigurationError(
            "Parquet needs pyarrow: pip install 'rotcal_ros[parquet]'"
        ) from error


class ByAngle:
    """What has arrays (n,) that belong to the same angles."""

    def to_dataframe(self) -> Any:
        """Return the arrays as a pandas DataFrame, SI: a row for each angle, ``angle_rad``.

        Only this needs pandas; without it ImportError says so.
        """
        arrays = {name: v for name, v in vars(self).items() if isinstance(v, np.ndarray)}
        return dataframe({_NAMES.get(name, name): v for name, v in arrays.items()})
