"""Repeated bidirectional runs as a plain table: ``angle_deg,run,direction,deviation_arcsec``."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.evaluation.iso230 import BidirectionalRuns
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import csv_rows
from rotcal_ros.foundation.units import ARCSEC, DEGREE

HEADER: Final = ("angle_deg", "run", "direction", "deviation_arcsec")
DIRECTIONS: Final = ("up", "down")
"""up: approached with increasing angle, down: with decreasing angle."""


def read_runs(text: str, name: str) -> BidirectionalRuns:
    """Return the runs in ``text``, the file ``name``.

    Every target must occur once in every run and direction. Raises BagError for other columns;
    DataError names what is missing, double or not a number.
    """
    found: dict[tuple[float, str, str], float] = {}
    reader = csv_rows(text, name)
    head = tuple(cell.strip() for cell in next(reader, []))
    if head != HEADER:
        columns = ", ".join(head) or "none"
        raise BagError(f"{name}: the columns are {columns}, expected {', '.join(HEADER)}")
    for row, cells in enumerate(reader, start=2):
        if cells:
            key, deviation = _row(cells, f"{name}, line {row}")
            if key in found:
                raise DataError(
                    f"{name}, line {row}: {key[0]:g} deg, run {key[1]} {key[2]} occurs twice"
                )
            found[key] = deviation
    targets = sorted({key[0] for key in found})
    runs = sorted({key[1] for key in found})
    missing = [
        f"{target:g} deg in run {run} {direction}"
        for target in targets
        for run in runs
        for direction in DIRECTIONS
        if (target, run, direction) not in found
    ]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise DataError(
            f"{name}: missing {', '.join(missing[:3])}{more}: measure them, or leave out the run"
        )
    up, down = (
        np.array([[found[target, run, d] for run in runs] for target in targets]) * ARCSEC
        for d in DIRECTIONS
    )
    return BidirectionalRuns(np.array(targets) * DEGREE, up, down)


def runs_of(result: Result) -> BidirectionalRuns | None:
    """Return the repeated runs of a result where both directions have two or more, else None.

    The covariance of the result beyond the scatter of the runs is common to them all.
    DataError names an arrival that is missing, or offsets between targets that are open.
    """
    runs = result.runs
    if runs is not None and (words := result.zeros.in_words(["ECC"])):
        raise DataError(
            f"{words}: figures of ISO 230-2 are ranges over all targets, and nothing would bound "
            "them"
        )
    if runs is None or runs.forward is None or runs.reverse is None or runs.forward.shape[1] < 2:
        return None
    measured = BidirectionalRuns(runs.targets, runs.forward, runs.reverse)
    covariance = result.covariance.get("ECC")
    if covariance is None or np.shape(covariance) != (len(runs.targets),) * 2:
        return measured
    return replace(measured, common=_common_to_all_runs(measured, covariance))


def with_device(runs: BidirectionalRuns, std: float) -> BidirectionalRuns:
    """Return ``runs`` with a standard uncertainty (rad) of the device at every target.

    It is the same in all runs, independent from target to target, and adds to what is known.
    """
    known = np.zeros((len(runs.targets),) * 2) if runs.common is None else runs.common
    return replace(runs, common=known + std**2 * np.eye(len(runs.targets)))


def _common_to_all_runs(runs: BidirectionalRuns, covariance: Floats) -> Floats:
    """Return the part of the covariance of the mean curve that no repetition shows.

    Noise and repeatability differ from run to run: they are in the scatter, and their share in the
    mean of all runs is subtracted. The mean counts from its first target.
    """
    n = runs.forward.shape[1]
    scatter = (runs.forward.var(axis=1, ddof=1) + runs.reverse.var(axis=1, ddof=1)) / 2.0
    tied = np.eye(len(scatter))
    tied[:, 0] -= 1.0
    counted = tied @ covariance @ tied.T  # whatever the zero of the result is
    rest = counted - float(scatter.mean()) / (2 * n) * tied @ tied.T
    values, vectors = np.linalg.eigh((rest + rest.T) / 2.0)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)


def require_runs(result: Result, source: str) -> BidirectionalRuns:
    """Return the runs of a result; DataError, naming ``source``, when it holds none."""
    runs = runs_of(result)
    if runs is None:
        raise DataError(
            f"{source}: the result holds no repeated runs in both directions; measure with the "
            "plan settings 'runs' (2 or more, the standard asks for 5) and 'bidirectional'"
        )
    return runs


def _row(cells: list[str], where: str) -> tuple[tuple[float, str, str], float]:
    if len(cells) != len(HEADER):
        raise DataError(f"{where}: {len(cells)} columns, expected {len(HEADER)}")
    angle, run, direction, deviation = (cell.strip() for cell in cells)
    if direction not in DIRECTIONS:
        raise DataError(f"{where}: direction {direction!r}, expected up or down")
    try:
        numbers = float(angle), float(deviation)
    except ValueError as error:
        raise DataError(f"{where}: {angle!r} or {deviation!r} is not a number") from error
    if not all(map(math.isfinite, numbers)):
        raise DataError(f"{where}: {angle!r} or {deviation!r} is not a finite number")
    return (numbers[0], run, direction), numbers[1]
