"""Turns a table into the texts of a controller's files, verified by the controller's own rule.

The verification shows how much of the deviation the controller's table removes, and how much is
left.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.agreement import require_verified
from rotcal_ros.compensation.controller import Controller, Lag, Rule
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.held_table import RESIDUAL, STATED, ZERO_DEG, hash_in_force
from rotcal_ros.compensation.interpolation_uncertainty import CERTAIN
from rotcal_ros.compensation.table import (
    DIRECTIONS,
    SIGN_CONVENTION,
    CompensationTable,
    Correction,
    average_directions,
    check_verdict,
    resample,
)
from rotcal_ros.compensation.writing import (
    WRITTEN,
    add_side_file,
    choose_stem,
    side_file_facts,
    without_provenance,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.circumstances import NOTHING_MEASURED
from rotcal_ros.foundation.components import COVERAGE_FACTOR, check_axis
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE
from rotcal_ros.foundation.curves.measured import gaps_of
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.in_force import describe, is_table_hash
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND, TURN

CONFIRMATION: Final = "confirmation_sha256"
CONTENTS: Final = "contents_sha256"
FIRST_ANGLE_DEG: Final = "first_angle_deg"
LAST_ANGLE_DEG: Final = "last_angle_deg"
NO_ZERO: Final = 1e-12
"""A forward correction at the reference angle, rad, that is only rounding."""


@dataclass(frozen=True)
class ExportFiles:
    """Names and texts of all files of one export with the provenance, and the error they leave.

    ``confirmation`` is the SHA-256 over every file, the table that it comes from, the controller
    with its settings, and what is left. It is the same for each repetition of an export, and is in
    the provenance too. ``controller`` has the values from the machine's own files, if the settings
    name them.
    """

    files: Mapping[str, str]
    residual: ResidualBudget
    warnings: tuple[str, ...]
    table: CompensationTable
    confirmation: str
    controller: Controller

    def describe(self) -> list[str]:
        """Return what the files do to the table in force, what they leave, and the warnings.

        At last what else the control does with the axis, and what switches the table on.
        """
        warnings = (f"warning: {warning}" for warning in self.warnings)
        return [
            describe_replacement(self.table), self.residual.describe(), *warnings,
            *other_control_settings(self.controller),
        ]  # fmt: skip

    def with_machine_files(self) -> dict[str, str]:
        """Return the files, and copies of the machine's own files that use them.

        Only a person puts such a copy into force. Raises ConfigurationError when one cannot be
        made, or has the name of another file.
        """
        controller_files = without_provenance(self.files)
        copies = self.controller.machine_files(self.table.axis, controller_files)
        if same := self.files.keys() & copies.keys():
            raise ConfigurationError(
                f"the copy of the machine's {', '.join(same)} would have the name of a file of "
                "the table: choose another name for the table"
            )
        return {**self.files, **copies}


def prepare_export(
    table: CompensationTable,
    controller_name: str,
    *,
    now: datetime,
    axis: str | None = None,
    spacing: float | None = None,
    reference_angle: float | None = None,
    settings: Mapping[str, Any] | None = None,
    stem: str | None = None,
    accept_unverified: bool = False,
    sources: Mapping[str, str] | None = None,
) -> ExportFiles:
    """Return the files for ``controller_name``, after reading them back and simulating it.

    ``axis`` is the axis they are meant for (refused when the table is another's), ``spacing``
    and ``reference_angle`` are radians (without a spacing see :func:`choose_row_spacing`),
    ``settings`` go to the controller, ``stem`` is the file name without extension (else axis and
    controller, and that of a simulation says so), ``sources`` maps what the numbers come from (a
    bag, a result) to its SHA-256. Unverified facts about a controller are refused unless
    ``accept_unverified``. Raises DataError for a verdict other than "ok" or a file that would make
    things worse, and ConfigurationError for limits, names and settings. Writes nothing.
    """
    controller = make_controller(controller_name, settings).for_axis(table.axis)
    _refuse(table, controller, axis, accept_unverified=accept_unverified)
    name = choose_stem(stem, default_stem(table.axis, controller_name), simulated=table.simulated)
    measured = resample(table, reference_angle=reference_angle)
    shifted = _completed(measured, controller)
    chosen = spacing is not None
    rows = resample(shifted, spacing) if chosen else choose_row_spacing(shifted, controller)
    files = controller.commented(controller.write(rows, name), other_control_settings(controller))
    if table.simulated:
        files = controller.marked(files, NOTHING_MEASURED)
    rule = controller.read(files)
    lag = controller.lag(rule, rows)
    residual = residual_budget(shifted, rows, controller, rule, lag, measured)
    _refuse_harm(residual, lag, controller.facts.title)
    warnings = (
        *_warnings(shifted, controller),
        *_too_wide(shifted, rows, residual, spacing),
        *lag.notes,
    )
    side = {
        **side_file_facts(files, now, sources),
        **_origin(table),
        "controller": controller_name,
        **_controller_facts(controller),
        **_written_rows(rows, files),
        **_left(residual, table),
        "warnings": list(warnings),
    }
    confirmation = _confirmation(side)
    return ExportFiles(
        files=add_side_file(files, name, {**side, CONFIRMATION: confirmation}),
        residual=residual,
        warnings=warnings,
        table=rows,
        confirmation=confirmation,
        controller=controller,
    )


def other_control_settings(controller: Controller) -> list[str]:
    """Return what else the control does with the axis, and what switches a table on."""
    last = [f"switch on: {controller.switch_on}"] if controller.switch_on else []
    return [*(own.describe() for own in controller.own_settings), *last]


def _completed(table: CompensationTable, controller: Controller) -> CompensationTable:
    """Return ``table`` with what the control corrects of itself until it is given a table.

    A measurement without a table has seen it act, one on top of a table has not.
    """
    note = controller.replaced(table)
    table = replace(table, warnings=(*table.warnings, *([note] if note else [])))
    up, down = map(controller.without_table, DIRECTIONS)
    if table.adds_to or up == down == 0.0:
        return table
    return replace(
        table,
        correction_forward=table.correction_forward + up,
        correction_reverse=table.correction_reverse + down,
        zero=table.zero + up,
    )


def _refuse(
    table: CompensationTable, controller: Controller, axis: str | None, *, accept_unverified: bool
) -> None:
    """Raise DataError or ConfigurationError for a table that may not be fed to ``controller``."""
    check_verdict(table)
    if is_table_hash(table.measured_on) and not table.adds_to:
        raise DataError(
            f"{describe(table.measured_on)}, and alone it would lose what that table corrects: "
            "add to it (rotcal export --add-to); nothing was written"
        )
    if axis is not None and check_axis(axis) != table.axis:
        raise ConfigurationError(
            f"the table is for axis {table.axis} and the export for axis {axis}: leave the "
            "axis out, or accept another one; nothing was written"
        )
    if not accept_unverified:
        require_verified(controller.facts.title, controller.unverified)


def _confirmation(side: Mapping[str, Any]) -> str:
    decided = {key: value for key, value in side.items() if key != WRITTEN}
    return hashlib.sha256(json.dumps(decided, sort_keys=True).encode()).hexdigest()


def default_stem(axis: str, controller_name: str) -> str:
    """Return the name of a controller's files without extension."""
    return f"{axis}_{controller_name}".lower()


def describe_replacement(table: CompensationTable) -> str:
    """Return in words whether ``table`` replaces the table in force or adds to it."""
    what = f"adds to the table {table.adds_to}" if table.adds_to else "replaces the table in force"
    return f"{what}; {describe(table.measured_on)}"


def _refuse_harm(residual: ResidualBudget, lag: Lag, title: str) -> None:
    """Refuse a file that leaves more than promised, or more than there was before."""
    if residual.simulated > residual.stated * (1.0 + 1e-9) + 1e-14:
        raise DataError(
            f"{title}: read back and applied by the control's rule, the file leaves "
            f"{residual.simulated / ARCSEC:.4g} arcsec, expected at most "
            f"{residual.stated / ARCSEC:.4g}: nothing was written"
        )
    if residual.simulated > residual.before + 1e-14:
        coarse = ("the control's resolution or the spacing is too coarse: choose a finer spacing",)
        why = "; ".join(lag.notes if lag.simulated else coarse)
        raise DataError(
            f"{title}: the table would leave {residual.simulated / ARCSEC:.4g} arcsec of a "
            f"deviation of {residual.before / ARCSEC:.4g}: {why}; nothing was written"
        )


def _warnings(table: CompensationTable, controller: Controller) -> tuple[str, ...]:
    line = table.verdict_line
    reserve = (f"the result is {line}",) if line not in ("", "ok") else ()
    if table.simulated:
        reserve = (f"{NOTHING_MEASURED} table", *reserve)
    unverified = (f"not verified: {text}" for text in controller.unverified)
    of_the_table = (
        average_directions(table).warnings if controller.one_direction else table.warnings
    )
    return (*reserve, *of_the_table, *unverified)


def _too_wide(
    table: CompensationTable,
    rows: CompensationTable,
    residual: ResidualBudget,
    spacing: float | None,
) -> tuple[str, ...]:
    """Return in words that the rows are too far apart, and what ``spacing`` helps."""
    if residual.interpolation <= allowed_interpolation_error(table):
        return ()
    widest = float(np.max(gaps_of(rows.angles, rows.period))) / DEGREE
    cure = "no rows that the controller takes leave less"
    if spacing is not None:
        cure = (
            "leave out the spacing: then the widest good rows that the controller takes are chosen"
        )
    return (
        f"between rows {widest:.6g} deg apart the control leaves up to "
        f"{residual.interpolation / ARCSEC:.2g} arcsec, more than a third of U "
        f"({COVERAGE_FACTOR * residual.std / ARCSEC:.2g} arcsec): {cure}",
    )


def _origin(table: CompensationTable) -> dict[str, Any]:
    """Return what the numbers come from."""
    return {
        "axis": table.axis,
        "item": table.item,
        "serial": table.serial,
        "measured_from": format_utc(table.measured_from_ns) if table.measured_from_ns else "",
        "measured_until": format_utc(table.measured_until_ns) if table.measured_until_ns else "",
        "simulated": table.simulated,
        "method": table.method,
        "verdict": table.verdict,
        "verdict_line": table.verdict_line,
        "table_sha256": table.table_hash,
        "measured_on": table.measured_on,
        "adds_to": table.adds_to,
        "in_force": describe_replacement(table),
        "sign_of_the_table": SIGN_CONVENTION,
    }


def format_utc(time_ns: int) -> str:
    """Return a time (ns since 1970) for people."""
    time = datetime.fromtimestamp(time_ns * NANOSECOND, timezone.utc)
    return time.isoformat(timespec="seconds")


def _controller_facts(controller: Controller) -> dict[str, Any]:
    words = asdict(controller.facts)
    return {
        "controller_title": words.pop("title"),
        "settings": asdict(controller),
        "own_settings": [own._asdict() for own in controller.own_settings],
        "switch_on": controller.switch_on,
        **words,
    }


def _written_rows(rows: CompensationTable, files: Mapping[str, str]) -> dict[str, Any]:
    zero = float(Correction(rows)(rows.reference_angle, DIRECTIONS[0]))
    return {
        CONTENTS: hash_in_force(files),
        "rows": len(rows.angles),
        "row_angles_deg": (rows.angles / DEGREE).tolist(),
        "closed": rows.closed,
        FIRST_ANGLE_DEG: float(rows.angles[0]) / DEGREE,
        LAST_ANGLE_DEG: float(rows.angles[-1]) / DEGREE,
        "widest_spacing_deg": float(np.max(np.diff(rows.angles))) / DEGREE,
        "reference_angle_deg": rows.reference_angle / DEGREE,
        **({ZERO_DEG: zero / DEGREE} if abs(zero) > NO_ZERO else {}),
    }


def _left(residual: ResidualBudget, table: CompensationTable) -> dict[str, Any]:
    figures = {**asdict(residual), STATED: residual.stated}
    return {
        "residual": residual.describe(),
        RESIDUAL: {part: value / ARCSEC for part, value in figures.items()},
        "blind_to": _blind_to(table),
    }


def _blind_to(table: CompensationTable) -> str:
    """Return in words what the measured angles and directions cannot show."""
    widest = table.widest_gap or float(np.max(gaps_of(table.angles, table.period)))
    orders = int(np.pi / widest + SAME_ANGLE)
    words = (
        f"what repeats more than {orders} times in a turn: the measured angles are up to "
        f"{widest / DEGREE:.6g} deg apart"
    )
    return words if table.directional else f"{words}; a reversal: both directions are equal"


POINTS_PER_ROW = 24
SHARE_OF_U: Final = 1.0 / 3.0
SPACINGS_DEG: Final = (
    30.0, 20.0, 15.0, 10.0, 7.5, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.2, 1.0, 0.75, 0.5,
)  # fmt: skip
"""Distances of rows that divide a turn, the widest first."""
NO_LAG = Lag()
SAMPLING = 1.02
"""The maximum over so fine a grid is below the true one by less than this factor."""


@dataclass(frozen=True)
class ResidualBudget:
    """Largest deviations in radians, over all angles and both directions.

    ``before`` is what there is without compensation. ``interpolation`` is the distance of the
    control's line (or staircase) between the rows from the smooth curve through the measured
    points, ``sampling`` bounds what that curve may miss between them, ``rounding`` comes from the
    digits or whole numbers of the file, ``direction`` from a control that has one column for both
    directions, ``second_order`` from looking the correction up at the commanded instead of the
    true angle. ``following`` is what remains if the control's correction does not follow its table
    at once. ``simulated`` is what the control's own rule leaves when it reads the written file;
    ``std`` the largest standard uncertainty (k = 1) of the correction, which no table removes.
    """

    before: float
    interpolation: float
    sampling: float
    rounding: float
    direction: float
    second_order: float
    simulated: float
    std: float
    following: float = 0.0

    @property
    def stated(self) -> float:
        """The bound on what is left: the sum of all six parts."""
        between_rows = self.interpolation + self.sampling
        return between_rows + self.rounding + self.direction + self.second_order + self.following

    def describe(self) -> str:
        """Return the figures in one line, in arcseconds."""
        parts = {
            "interpolation": self.interpolation,
            "between the measured angles": self.sampling,
            "rounding": self.rounding,
            "one column for both directions": self.direction,
            "second order": self.second_order,
            "where the correction stands": self.following,
        }
        listed = ", ".join(
            f"{name} {value / ARCSEC:.2g}" for name, value in parts.items() if value
        )
        return (
            f"largest deviation {self.before / ARCSEC:.4g} arcsec, after compensation at most "
            f"{self.stated / ARCSEC:.3g} arcsec ({listed}), {self.simulated / ARCSEC:.3g} arcsec "
            f"by the control's own rule; standard uncertainty {self.std / ARCSEC:.2g} arcsec"
        )


def allowed_interpolation_error(table: CompensationTable) -> float:
    """Return what the lines between the rows may leave, rad: a third of U (k = 2).

    A measurement of the same kind would see more. Infinite if U is not known.
    """
    return COVERAGE_FACTOR * table.largest_std * SHARE_OF_U or np.inf


def choose_row_spacing(table: CompensationTable, controller: Controller) -> CompensationTable:
    """Return ``table`` on the widest rows between which the control keeps the demand.

    Its own rows are tried first. If no rows that ``controller`` takes are narrow enough, those
    that leave least are returned. Raises ConfigurationError, with the reason for its own rows,
    when the controller takes none at all.
    """
    best, least, refused = None, np.inf, None
    asked = controller.row_spacings_deg or SPACINGS_DEG
    for spacing in (None, *(degrees * DEGREE for degrees in asked)):
        try:
            rows = resample(table, spacing)
            controller.write(rows, "x")
        except ConfigurationError as error:
            refused = refused or error
            continue
        left = largest_interpolation_error(table, rows, controller)
        if left <= allowed_interpolation_error(table):
            return rows
        if left < least:
            best, least = rows, left
    if best is None:
        assert refused is not None
        raise refused
    return best


def largest_interpolation_error(
    table: CompensationTable, rows: CompensationTable, controller: Controller
) -> float:
    """Return how far (rad) the control is at most from the curve of ``table`` between ``rows``."""
    grid = _fine_grid(table, rows)
    smooth, written = table, rows
    if controller.one_direction:
        smooth, written = average_directions(table), average_directions(rows)
    columns = (written.correction_forward, written.correction_reverse)
    return SAMPLING * max(
        _largest(
            _neighbours(written, column, grid, controller.staircase)
            - Correction(smooth)(grid, approach)
        )
        for column, approach in zip(columns, DIRECTIONS, strict=True)
    )


def residual_budget(
    table: CompensationTable,
    rows: CompensationTable,
    controller: Controller,
    rule: Rule,
    lag: Lag = NO_LAG,
    measured: CompensationTable | None = None,
) -> ResidualBudget:
    """Return what is left of the deviations in ``table`` when the control follows ``rule``.

    ``table`` holds the measured rows (their smooth curve counts as true), ``rows`` those that
    ``controller`` wrote, ``rule`` is what it read from its files, ``lag`` what comes too late.
    ``measured`` is ``table`` without what the control did by itself, if it did anything.
    """
    grid = _fine_grid(table, rows)
    needed = [Correction(table)(grid, approach) for approach in DIRECTIONS]
    direction = 0.0
    if controller.one_direction:
        goal = [Correction(average_directions(table))(grid, approach) for approach in DIRECTIONS]
        direction = SAMPLING * _largest(np.subtract(needed, goal))
    steepest = SAMPLING * _largest(np.gradient(np.array(needed), grid, axis=1))
    interpolation = largest_interpolation_error(table, rows, controller)
    rounding = controller.resolution(rows) / 2.0
    rounding += steepest * controller.position_resolution
    sampling = CERTAIN * table.between_std
    whole = _largest(needed)
    seen = whole
    if measured is not None:
        seen = _largest([Correction(measured)(grid, approach) for approach in DIRECTIONS])
    return ResidualBudget(
        before=seen,
        interpolation=interpolation,
        sampling=sampling,
        rounding=rounding,
        direction=direction,
        second_order=steepest * (whole + interpolation + sampling + rounding + direction),
        simulated=simulate(table, controller, rule, grid) + lag.simulated,
        std=table.largest_std,
        following=lag.bound,
    )


def simulate(table: CompensationTable, controller: Controller, rule: Rule, grid: Floats) -> float:
    """Return the largest deviation (rad) left on ``grid`` (rad, one turn or the arc).

    The axis has the deviations of ``table``; it is commanded to every angle from both sides in
    every turn that the file is made for, and moves by what the control makes of the file.
    """
    first, last = controller.travel if table.closed else (0.0, TURN)
    truth = Correction(table)
    worst = 0.0
    for turn in range(round(first / TURN), round(last / TURN)):
        for approach in DIRECTIONS:
            command = grid + turn * TURN
            correction = rule.correction(command, approach)
            moved = command + correction
            if not table.closed:
                moved = np.clip(moved, table.angles[0], table.angles[-1])
            worst = max(worst, _largest(correction - truth(moved, approach)))
    return worst


def _fine_grid(table: CompensationTable, rows: CompensationTable) -> Floats:
    """Return angles that hold all rows and many points between any two of them."""
    ends = np.append(rows.angles, TURN) if table.closed else rows.angles
    knots = np.unique(np.concatenate([ends, table.angles]))
    knots = knots[np.append(True, np.diff(knots) > SAME_ANGLE)]
    share = np.arange(POINTS_PER_ROW) / POINTS_PER_ROW
    between = knots[:-1, None] + np.diff(knots)[:, None] * share
    return np.append(between.ravel(), knots[-1])


def _neighbours(rows: CompensationTable, column: Floats, grid: Floats, staircase: bool) -> Floats:
    """Return what the control may give between the rows: one line, or either neighbour (2, n)."""
    knots, values = rows.angles, column
    if rows.closed:
        knots, values = np.append(knots, knots[0] + TURN), np.append(values, values[0])
    if not staircase:
        return np.interp(grid, knots, values)[None, :]
    left = np.clip(np.searchsorted(knots, grid, side="right") - 1, 0, len(knots) - 2)
    return np.vstack([values[left], values[left + 1]])


def _largest(values: Any) -> float:
    return float(np.max(np.abs(np.asarray(values))))
