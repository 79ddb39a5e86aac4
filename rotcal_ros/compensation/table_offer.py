"""A table that arrived: whether it can be believed, and its files for the person who confirms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.export import WRITTEN, ExportFiles, default_stem, prepare_export
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.compensation.writing import PROVENANCE, write_files
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.foundation.untrusted import load_json, read_bytes

MAX_STD_RATIO: Final = 3.0
"""Ratio of standard uncertainty and largest correction above which a table is refused."""
MAX_AHEAD_NS: Final = 1_000_000_000
"""The clock of the solver may be ahead of ours by so much."""


@dataclass(frozen=True)
class TableOffer:
    """A table, made at ``stamp_ns``, and the files that it becomes when it is applied.

    ``paths`` are those for people, empty where none are written. ``files`` are their texts.
    """

    table: CompensationTable
    stamp_ns: int
    export: ExportFiles
    files: Mapping[str, str]
    paths: tuple[Path, ...]

    @property
    def confirmation(self) -> str:
        """The hash over files and options that confirms this offer."""
        return self.export.confirmation

    def refuse_changed(self) -> None:
        """Raise DataError unless the files for people are those that would be applied."""
        for path in self.paths:
            if _text(path) != self.files[path.name]:
                raise DataError(
                    f"{path} was changed since it was written, so that what was looked at is not "
                    "what would be applied: take the folder away and publish the table again"
                )


def make_offer(
    table: CompensationTable, stamp_ns: int, settings: BridgeSettings, axis: str, now_ns: int
) -> TableOffer:
    """Check ``table`` against the configuration, and write its files for people.

    They go into a folder of their own, named after their hash; one that holds exactly these
    files already is used again. Raises RotcalError when the table cannot be fed to this
    controller, or the folder holds anything else.
    """
    _refuse_unbelievable(table, stamp_ns, now_ns)
    reference = settings.reference_deg
    export = prepare_export(
        table,
        settings.controller,
        now=datetime.fromtimestamp(now_ns * NANOSECOND, timezone.utc),
        axis=axis,
        spacing=settings.spacing_deg * DEGREE or None,
        reference_angle=None if reference is None else reference * DEGREE,
        settings=settings.controller_settings,
        # The controller knows its file under one name, whatever is in it.
        stem=default_stem(table.axis, settings.controller),
        accept_unverified=settings.accept_unverified,
    )
    if not settings.output_folder:
        return TableOffer(table, stamp_ns, export, export.files, ())
    folder = Path(settings.output_folder) / f"{table.axis}-{export.confirmation}".lower()
    if not folder.is_dir() or not any(folder.iterdir()):
        return TableOffer(table, stamp_ns, export, export.files, write_files(export.files, folder))
    files = _looked_at(folder, export.files)
    return TableOffer(table, stamp_ns, export, files, tuple(folder / name for name in files))


def _refuse_unbelievable(table: CompensationTable, stamp_ns: int, now_ns: int) -> None:
    ahead_ns = stamp_ns - now_ns
    if ahead_ns > MAX_AHEAD_NS:
        raise DataError(
            f"the table is stamped {ahead_ns * NANOSECOND:.4g} s in the future: set the clocks of "
            "solver and bridge, and solve again"
        )
    columns = np.abs([table.correction_forward, table.correction_reverse])
    largest, std = float(np.max(columns)), table.largest_std
    if std > MAX_STD_RATIO * largest:
        raise DataError(
            f"the table's largest standard uncertainty, {std / ARCSEC:.4g} arcsec, is more than "
            f"{MAX_STD_RATIO:g} times its largest correction, {largest / ARCSEC:.4g} arcsec: "
            "there is nothing to gain from it"
        )


def _looked_at(folder: Path, files: Mapping[str, str]) -> dict[str, str]:
    """Return the texts in ``folder``; DataError unless only the time of writing may differ."""
    found = {path.name: _text(path) for path in folder.iterdir()}
    texts = {name: text for name, text in found.items() if text is not None}
    wrong = [n for n in found.keys() | files.keys() if not _same(n, texts.get(n), files.get(n))]
    if wrong:
        raise DataError(
            f"{folder} does not hold exactly the files of this table "
            f"({', '.join(sorted(wrong))}): take the folder away and publish the table again"
        )
    return {name: texts[name] for name in files}


def _same(name: str, found: str | None, wanted: str | None) -> bool:
    if found is None or wanted is None or not name.endswith(PROVENANCE):
        return found is not None and found == wanted
    try:
        sides = [load_json(text) for text in (found, wanted)]
        return bool(sides[0] == {**sides[1], WRITTEN: sides[0][WRITTEN]})
    except (ValueError, TypeError, KeyError):
        return False


def _text(path: Path) -> str | None:
    """Return the text of a plain file, None for anything else."""
    if path.is_symlink() or not path.is_file():
        return None
    return read_bytes(path).decode("latin-1")
