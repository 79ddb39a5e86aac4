"""Turns a result into the files of a controller, or a correction for your own software."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal

from numpy.typing import ArrayLike

from rotcal_ros.api.reading import Name
from rotcal_ros.compensation.agreement import LARGEST_AGE_DAYS, AcceptedConflicts, MachineIdentity
from rotcal_ros.compensation.earlier_export import combine_with_earlier_export
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import (
    CompensationTable,
    Correction,
    check_verdict,
    measured_axis,
    table_from_result,
)
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result


def make_table(
    result: Result,
    *,
    reverse: Result | None = None,
    axis: str = "",
    reference_angle: float | None = None,
    spacing: float | None = None,
    harmonics: int | None = None,
) -> CompensationTable:
    """Turn the ECC deviations of a result into a compensation table of the positioning.

    Correction = -deviation = commanded - actual: add it to the command. ``angles``,
    ``correction_forward``, ``correction_reverse`` and ``std`` (k = 1) are (n,) rad. ``reverse`` is
    the result of the approach with decreasing angle; ``axis`` need not be stated if the result has
    it, and is C if it is not known; ``reference_angle`` (rad) is where the correction is zero;
    ``spacing`` (rad) puts rows between the measured angles, on a spline or on the fit of so many
    ``harmonics``. Raises DataError for a result without ECC, that does not close, or whose parts
    have unconnected zeros; ConfigurationError for an axis that is not the measured one, or an
    impossible axis or spacing.

    >>> import rotcal_ros as rc
    >>> table = rc.make_table(rc.read_result("examples/data/result_ball_plate.json"))
    >>> table.axis, len(table.angles), table.closed
    ('C', 12, True)
    """
    for measured in (result,) if reverse is None else (result, reverse):
        if measured.zeros.free:
            check_verdict(measured)
    return table_from_result(
        result,
        reverse=reverse,
        axis=measured_axis(result, reverse, axis),
        reference_angle=reference_angle,
        spacing=spacing,
        harmonics=harmonics,
    )


def correction(
    table: CompensationTable,
    angle: ArrayLike,
    approach: Literal["positive", "negative"] = "positive",
) -> Floats:
    """Look the correction up (rad), in the shape of ``angle`` (rad): add it to the command.

    The periodic cubic spline through the rows of the table. ``approach`` is the side from which
    the table comes. Raises DataError outside a table that covers only an arc, ConfigurationError
    for another side.

    >>> import rotcal_ros as rc
    >>> table = rc.make_table(rc.read_result("examples/data/result_ball_plate.json"))
    >>> command = 30 * rc.DEGREE
    >>> bool(rc.correction(table, command) == table.correction_forward[1])
    True
    """
    sides = {"positive": Approach.POSITIVE, "negative": Approach.NEGATIVE}
    if approach not in sides:
        raise ConfigurationError(f"approach {approach!r}: expected {' or '.join(sides)}")
    return Correction(table)(angle, sides[approach])


def write_controller_files(
    table: CompensationTable,
    controller: str,
    folder: Name,
    *,
    spacing: float | None = None,
    settings: Mapping[str, Any] | None = None,
    name: str | None = None,
    accept_unverified: bool = False,
    replaces: bool = False,
    add_to: Name | None = None,
    axis: str = "",
    serial: str = "",
    accept: Sequence[str] = (),
    largest_age_days: float = LARGEST_AGE_DAYS,
) -> tuple[Path, ...]:
    """Write the table for one of ``controller_names()`` into ``folder``; return the files.

    They are read back and run through the controller's own rule before they are written, all or
    none, and nothing is overwritten. ``spacing`` is the distance of the rows in rad, ``settings``
    go to the controller, ``name`` begins the file names. ``axis`` and ``serial`` are those of the
    machine, as far as stated: a table of another one, or of a measurement older than
    ``largest_age_days``, is refused unless ``accept`` has the word "axis", "serial" or "age".
    If the result does not know which table was in force, one of two has to be given: ``replaces``
    (none was), or the folder ``add_to`` with the files of that table. Raises DataError for a
    contradiction, for a verdict other than ok and for a file that would make things worse,
    ConfigurationError for what the controller cannot take or that is not verified (unless
    ``accept_unverified``), BagError if the files cannot be written.

    >>> import tempfile
    >>> import rotcal_ros as rc
    >>> table = rc.make_table(rc.read_result("examples/data/result_ball_plate.json"))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = rc.write_controller_files(table, "csv", folder, replaces=True)
    >>> sorted(file.name for file in files)
    ['c_csv_simulated.csv', 'c_csv_simulated.provenance.json']
    """
    now = datetime.now(timezone.utc)
    export = prepare_export(
        combine_with_earlier_export(
            table,
            controller,
            {"the machine (axis, serial)": MachineIdentity(axis, serial)},
            AcceptedConflicts(tuple(accept), largest_age_days),
            int(now.timestamp()) * 1_000_000_000,
            replaces=replaces,
            add_to=None if add_to is None else Path(add_to),
        ),
        controller,
        now=now,
        spacing=spacing,
        settings=settings,
        stem=name,
        accept_unverified=accept_unverified,
    )
    return write_files(export.files, Path(folder))
