"""ADS: the table as an array of LREAL in a TwinCAT runtime, and a count that puts it in force.

The count is 0 while the array is written; only when the array was read back and has the same
bits does the count become the number of rows. A PLC that takes rows only while the count is not
0 never sees half a table. Source: Beckhoff TwinCAT ADS, through pyads.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyads

from rotcal_controllers.network_stores.settings import AdsSettings
from rotcal_controllers.network_stores.store import NetworkStore
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.plain_csv import COLUMNS, PlainCsv
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, ControllerError

REQUESTS_BY_NAME: Final = 3
"""A handle, the value, and the handle given back."""


class AdsLink:
    """A link to one table in a TwinCAT runtime; ``timeout_s`` for each access.

    Raises ConfigurationError when ``controller`` has no table of numbers.
    """

    def __init__(self, settings: AdsSettings, timeout_s: float, controller: Controller) -> None:
        if not isinstance(controller, PlainCsv):
            raise ConfigurationError(
                f"bridge.transport ads carries arrays of numbers, and {controller.facts.title} "
                "has none: choose the controller csv"
            )
        self._settings, self._timeout_s, self._form = settings, timeout_s, controller
        self.address = f"ads://{settings.host}/{settings.net_id}:{settings.port}/{settings.table}"

    def read(self, names: list[str]) -> dict[str, str]:
        """Return the table that is in force as the text of its file."""
        name = self._only(names)
        with self._connected("read") as plc:
            rows = self._count(plc)
            if rows > self._settings.capacity:
                raise ControllerError(
                    f"{self.address}: {rows} rows in force, and ads.capacity is "
                    f"{self._settings.capacity}: set it to the length of the array"
                )
            array = self._array(plc)[:rows]
        return {name: self._form.text_of(array)} if rows else {}

    def write(self, tables: Mapping[str, str | None]) -> None:
        """Replace the table; None removes it."""
        name = self._only(list(tables))
        text = tables[name]
        rows = np.zeros((0, COLUMNS)) if text is None else self._form.rows_of(name, text)
        capacity = self._settings.capacity
        if len(rows) > capacity:
            raise ControllerError(
                f"{self.address}: {len(rows)} rows, the array holds ads.capacity = {capacity}: "
                "choose a wider spacing, or enlarge both"
            )
        array = np.zeros((capacity, COLUMNS))
        array[: len(rows)] = rows
        with self._connected("write") as plc:
            # The PLC must not use rows of two tables: none is in force while the array changes.
            self._set_count(plc, 0)
            self._set_array(plc, array)
            # Compared bit by bit: NaN is unequal to itself, and -0.0 equals 0.0.
            if self._array(plc).tobytes() != array.tobytes():
                raise ControllerError(
                    f"{self.address}: read back, the array differs from what was written; "
                    f"{self._settings.count} stays 0, so that no table is in force"
                )
            if len(rows):
                self._set_count(plc, len(rows))

    def _count(self, plc: TwinCatRuntime) -> int:
        return int(plc.read(self._settings.count, pyads.PLCTYPE_UDINT))

    def _set_count(self, plc: TwinCatRuntime, rows: int) -> None:
        plc.write(self._settings.count, rows, pyads.PLCTYPE_UDINT)
        if self._count(plc) != rows:
            raise ControllerError(f"{self.address}: {self._settings.count} does not become {rows}")

    def _array(self, plc: TwinCatRuntime) -> Floats:
        kind = pyads.PLCTYPE_LREAL * (self._settings.capacity * COLUMNS)
        values = plc.read(self._settings.table, kind)
        return np.array(values, dtype=np.float64).reshape(-1, COLUMNS)

    def _set_array(self, plc: TwinCatRuntime, array: Floats) -> None:
        kind = pyads.PLCTYPE_LREAL * array.size
        plc.write(self._settings.table, array.ravel().tolist(), kind)

    def _only(self, names: list[str]) -> str:
        if len(names) != 1:
            raise ControllerError(
                f"{self.address}: one array holds one table, not {names}; "
                "choose a controller with one file"
            )
        return names[0]

    @contextmanager
    def _connected(self, what: str) -> Iterator[TwinCatRuntime]:
        settings = self._settings
        end_s = time.monotonic() + self._timeout_s  # also of the connection, which may take long
        plc = pyads.Connection(settings.net_id, settings.port, settings.host)
        try:
            with plc:
                yield TwinCatRuntime(plc, end_s)
        except (pyads.ADSError, RuntimeError, ValueError, TypeError, TimeoutError) as error:
            raise ControllerError(
                f"{self.address}: cannot {what}: {error}; check ads.host, ads.net_id and "
                "ads.port, and the route to this machine"
            ) from error


class TwinCatRuntime:
    """The variables of a runtime; nothing begins after ``end_s`` of the monotonic clock."""

    def __init__(self, plc: pyads.Connection, end_s: float) -> None:
        self._plc, self._end_s = plc, end_s

    def read(self, name: str, kind: Any) -> Any:
        """Return the value of a variable; TimeoutError if the time is over."""
        self._limit()
        return self._plc.read_by_name(name, kind)

    def write(self, name: str, value: Any, kind: Any) -> None:
        """Set the value of a variable; TimeoutError if the time is over."""
        self._limit()
        self._plc.write_by_name(name, value, kind)

    def _limit(self) -> None:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("not done in time")
        # One access by name makes several requests, and each may take the whole time-out.
        self._plc.set_timeout(math.ceil(1000 * left_s / REQUESTS_BY_NAME))


def ads_store(
    settings: AdsSettings, folder: Path, timeout_s: float, controller: Controller
) -> NetworkStore:
    """Return the store of a TwinCAT runtime; its records are in ``folder``."""
    return NetworkStore(AdsLink(settings, timeout_s, controller), folder, timeout_s)
