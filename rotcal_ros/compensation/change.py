"""How far two sets of controller files differ: the largest change of the correction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.export import FIRST_ANGLE_DEG, LAST_ANGLE_DEG
from rotcal_ros.compensation.table import DIRECTIONS
from rotcal_ros.compensation.writing import PROVENANCE, of_the_controller
from rotcal_ros.errors import ControllerError, RotcalError
from rotcal_ros.observations import Approach
from rotcal_ros.units import DEGREE
from rotcal_ros.untrusted import load_json

GRID_STEP: Final = 0.25 * DEGREE
"""Angles (rad) at which two corrections are compared."""


def largest_change(
    controller: Controller, old: Mapping[str, str], new: Mapping[str, str], *rows: Floats
) -> float:
    """Return the largest difference (rad) of what the controller makes of both.

    Both directions are compared over the whole travel, over the span of both tables, which may lie
    outside of it, and at further angles ``rows`` (rad). Raises ControllerError when files cannot
    be read.
    """
    first, last = controller.travel
    count = round((last - first) / GRID_STEP) + 1
    spans = [(first, last), *_spans(old), *_spans(new)]
    grid = np.concatenate([*(np.linspace(*span, count) for span in spans), *rows])
    differences = [
        np.abs(_correction(controller, new, grid, a) - _correction(controller, old, grid, a))
        for a in DIRECTIONS
    ]
    return float(np.max(differences))


def _spans(files: Mapping[str, str]) -> list[tuple[float, float]]:
    """Return first and last angle (rad) of our own tables; of others they are not known."""
    sides = (text for name, text in files.items() if name.endswith(PROVENANCE))
    return [span for text in sides if (span := _span(text)) is not None]


def _span(provenance: str) -> tuple[float, float] | None:
    try:
        side = load_json(provenance)
        return side[FIRST_ANGLE_DEG] * DEGREE, side[LAST_ANGLE_DEG] * DEGREE
    except (ValueError, TypeError, KeyError):
        return None  # written by hand


def _correction(
    controller: Controller, files: Mapping[str, str], grid: Floats, approach: Approach
) -> Floats:
    tables = of_the_controller(files)
    if not tables:
        return np.zeros_like(grid)
    try:
        rule = controller.read(tables)
    except RotcalError as error:
        raise ControllerError(
            f"the table that the controller holds cannot be read, so that the change is not "
            f"known ({error}): look at it and move it away by hand; nothing was changed"
        ) from error
    return rule.correction(grid, approach)
