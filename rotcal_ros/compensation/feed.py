"""Feeding a controller: on confirmation only, the old table kept, the new one read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.controller_folder import STATE_FOLDER, ControllerFolder
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import ExportFiles, prepare_export
from rotcal_ros.compensation.journal import Entry, Journal
from rotcal_ros.compensation.quality import DIRECTIONS
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.errors import ControllerError, DataError, RotcalError
from rotcal_ros.observations import Approach
from rotcal_ros.units import ARCSEC, DEGREE, NANOSECOND

GRID_STEP = 0.25 * DEGREE
"""Angles (rad) at which two corrections are compared, besides all of the new rows."""


@dataclass(frozen=True)
class Applied:
    """What was done: the controller's files, the folder with the old ones, change in rad."""

    files: tuple[Path, ...]
    backup: Path
    largest_change: float


@dataclass(frozen=True)
class Offer:
    """A table that arrived, made at ``stamp_ns``, and the files that it would become."""

    table: CompensationTable
    stamp_ns: int
    export: ExportFiles


class Feed:
    """The feed of one controller for one axis.

    ``now_ns`` returns the time (ns since 1970). ``store`` replaces the controller's folder of
    the settings.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        axis: str,
        now_ns: Callable[[], int],
        store: ControllerFolder | None = None,
    ) -> None:
        self.settings, self.axis = settings, axis
        self._now_ns = now_ns
        self._controller = make_controller(settings.controller, settings.controller_settings)
        self._folder = Path(settings.controller_folder)
        self._store = store or ControllerFolder(self._folder, settings.answer_timeout_s)
        self._journal = Journal(self._folder / STATE_FOLDER)
        self.offer: Offer | None = None

    def take(self, table: CompensationTable, stamp_ns: int) -> tuple[Path, ...]:
        """Hold ``table`` against the configuration, keep it, and write its files.

        Returns the files: a new folder below the output folder, or the one that holds this
        very table already. Raises RotcalError, and forgets the table before, when it cannot
        be fed to this controller.
        """
        self.offer = None
        settings = self.settings
        reference = settings.reference_deg
        export = prepare_export(
            table,
            settings.controller,
            now=datetime.fromtimestamp(self._now_ns() * NANOSECOND, timezone.utc),
            axis=self.axis,
            spacing=settings.spacing_deg * DEGREE,
            reference_angle=None if reference is None else reference * DEGREE,
            settings=settings.controller_settings,
            accept_unverified=settings.accept_unverified,
        )
        self.offer = Offer(table, stamp_ns, export)
        if not settings.output_folder:
            return ()
        folder = Path(settings.output_folder) / f"{table.axis}-{table.table_hash[:12]}".lower()
        if folder.is_dir() and any(folder.iterdir()):
            return tuple(sorted(folder.iterdir()))
        return write_files(export.files, folder)

    def apply(self, table_hash: str) -> Applied:
        """Give the table to the controller; ``table_hash`` confirms that it is the one meant.

        Keeps the old table, writes, reads back and compares. When the controller holds
        anything else afterwards the old table is put back and ControllerError raised.
        """
        offer = self._confirmed(table_hash)
        self._refuse_no_controller()
        self._store.lock()
        self._refuse_stale(offer)
        new = dict(offer.export.files)
        old = self._store.read(new)
        change = self._largest_change(old, new)
        limit = self.settings.max_change_arcsec * ARCSEC
        if change > limit:
            raise DataError(
                f"the table changes the correction by up to {change / ARCSEC:.4g} arcsec, "
                f"max_change_arcsec is {limit / ARCSEC:.4g}: nothing was changed"
            )
        before: dict[str, str | None] = {name: old.get(name) for name in new}
        now_ns = self._now_ns()
        entry = Entry("applying", now_ns, table_hash, self._journal.keep(before, now_ns))
        self._journal.note(entry)
        self._replace(new, before, entry)
        self._journal.note(replace(entry, action="applied", time_ns=self._now_ns()))
        paths = tuple(self._folder / name for name in new)
        return Applied(paths, self._journal.folder / entry.backup, change)

    def restore(self) -> Applied:
        """Put back what the controller held before the last table that was applied."""
        self._refuse_no_controller()
        self._store.lock()
        entry = self._journal.to_undo()
        if entry is None:
            raise DataError("no table was applied here that could be taken back")
        kept = self._journal.kept(entry.backup)
        present = self._store.read(kept)
        self._store.write(kept)
        self._compare(kept)
        self._journal.note(replace(entry, action="restored", time_ns=self._now_ns()))
        old = {name: text for name, text in kept.items() if text is not None}
        try:
            change = self._largest_change(present, old)
        except RotcalError:  # a half-written table has no correction to compare with
            change = float("nan")
        paths = tuple(self._folder / name for name in old)
        return Applied(paths, self._journal.folder / entry.backup, change)

    def close(self) -> None:
        """Let another bridge feed the controller."""
        self._store.close()

    def _confirmed(self, table_hash: str) -> Offer:
        if self.offer is None:
            raise DataError("no table has arrived that this controller could be fed with")
        found = self.offer.table.table_hash
        if table_hash != found:
            raise DataError(
                f"the table here has the hash {found}, the confirmation is for "
                f"{table_hash or 'none'}: look at the table and confirm this hash"
            )
        return self.offer

    def _refuse_no_controller(self) -> None:
        if not self.settings.controller_folder:
            raise DataError(
                "no controller is configured (bridge.controller_folder is empty): copy the "
                "written files by hand"
            )

    def _refuse_stale(self, offer: Offer) -> None:
        restored_ns = self._journal.last_restore_ns()
        if offer.stamp_ns <= restored_ns:
            age = (restored_ns - offer.stamp_ns) * NANOSECOND
            raise DataError(
                f"the table is stale: it was made {age:.0f} s before the controller's old table "
                "was restored; measure again with what the controller holds now"
            )

    def _largest_change(self, old: Mapping[str, str], new: Mapping[str, str]) -> float:
        """Return the largest difference (rad) of what the controller makes of both."""
        first, last = self._controller.travel
        count = round((last - first) / GRID_STEP) + 1
        grid = np.linspace(first, last, count)
        if self.offer is not None:
            rows = self.offer.export.table.angles
            between = np.linspace(rows[0], rows[-1], count)  # an arc may lie outside of the travel
            grid = np.concatenate([grid, between, rows])
        differences = [
            np.abs(self._correction(new, grid, a) - self._correction(old, grid, a))
            for a in DIRECTIONS
        ]
        return float(np.max(differences))

    def _correction(self, files: Mapping[str, str], grid: Floats, approach: Approach) -> Floats:
        tables = {n: t for n, t in files.items() if not n.endswith(".provenance.json")}
        if not tables:
            return np.zeros_like(grid)
        try:
            rule = self._controller.read(tables)
        except RotcalError as error:
            raise ControllerError(
                f"the table that the controller holds cannot be read, so that the change is not "
                f"known ({error}): look at it and move it away by hand; nothing was changed"
            ) from error
        return rule.correction(grid, approach)

    def _replace(
        self, new: Mapping[str, str], before: Mapping[str, str | None], entry: Entry
    ) -> None:
        """Write ``new`` and read it back; when that fails put ``before`` back."""
        try:
            self._store.write(new)
            self._compare(new)
        except ControllerError as error:
            place = self._journal.folder / entry.backup
            try:
                self._store.write(before)
                self._compare(before)
                self._journal.note(replace(entry, action="rolled_back", time_ns=self._now_ns()))
            except (ControllerError, OSError) as second:
                raise ControllerError(
                    f"{error}; putting the old table back failed too ({second}): it is not known "
                    f"what the controller holds. The old table is in {place}; restore it before "
                    "the axis moves"
                ) from second
            raise ControllerError(f"{error}; the old table was put back") from error

    def _compare(self, wanted: Mapping[str, str | None]) -> None:
        found = self._store.read(wanted)
        wrong = sorted(name for name, text in wanted.items() if found.get(name) != text)
        if wrong:
            raise ControllerError(
                f"read back, the controller's {', '.join(wrong)} differ from what was written"
            )
