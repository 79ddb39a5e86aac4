"""Where rotary axes stand, as the parameters of a controller's kinematics.

A result of :mod:`~rotcal_ros.methods.table_balls` gives the axis average line of the table, and
of the axis that tilts it, in the machine's coordinates. A controller that moves the tool with the
table has numbers for this; each kind writes its own (:meth:`.controller.Controller.locate`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.agreement import require_verified
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.table import check_verdict
from rotcal_ros.compensation.writing import add_side_file, choose_stem, side_file_facts
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.circumstances import NOTHING_MEASURED
from rotcal_ros.foundation.components import COVERAGE_FACTOR, check_axis
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import AxisLine, Result
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE, MILLIMETRE

KIND: Final = "rotcal_axis_location"
LENGTH_DECIMALS: Final = 6
"""Decimals of millimetres and degrees: nanometres, a hundredth of an arcsecond."""


def describe_axis_line(line: AxisLine) -> str:
    """Return place and lean with U (k = 2); files of controllers hold no other signs."""
    x, y, z = line.point / MILLIMETRE
    parts = []
    for name, value, std in zip(line.names, line.value, line.std, strict=True):
        unit, word = (MICROMETRE, "um") if name[0] in "XYZ" else (ARCSEC, "arcsec")
        u = COVERAGE_FACTOR * std / unit
        parts.append(f"{name} {value / unit:.4g} {word} (U {u:.2g})")
    turns = {1: "", -1: ", which turns clockwise,", 0: ", whose sense is not known,"}[line.sense]
    return f"{line.letter}{turns} at ({x:.4f}, {y:.4f}, {z:.4f}) mm: {', '.join(parts)}"


def prepare_location(
    result: Result,
    controller_name: str,
    controller: Controller,
    *,
    now: datetime,
    axis: str = "C",
    stem: str | None = None,
    accept_unverified: bool = False,
    sources: Mapping[str, str] | None = None,
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the files that show a ``controller`` where the axes are, and what to know of them.

    ``stem`` is the file name without extension (else axis, controller, "axis"), ``sources`` maps
    what the numbers come from to its SHA-256. Raises DataError for a verdict other than "ok" and a
    result without place, ConfigurationError for a controller that has no such parameters, or whose
    meaning is not verified, unless ``accept_unverified``. Writes nothing.
    """
    check_verdict(result)
    if not result.axes:
        raise DataError(
            f"the {result.method} result does not say where the axis stands: measure with "
            "table_balls, or leave out --what axis"
        )
    usual = f"{check_axis(axis)}_{controller_name}_axis"
    name = choose_stem(stem, usual, simulated=result.simulated)
    head = [
        *(describe_axis_line(line) for line in result.axes),
        *([NOTHING_MEASURED] if result.simulated else []),
    ]
    located = controller.locate(result.axes, name, head)
    if not accept_unverified:
        require_verified(controller.facts.title, located.unverified)
    notes = (*located.notes, *(f"not verified: {text}" for text in located.unverified))
    side = {
        **side_file_facts(located.files, now, sources),
        "kind": KIND,
        "controller": controller_name,
        "controller_title": controller.facts.title,
        "settings": asdict(controller),
        "source": located.source,
        **result_provenance(result),
        "axes": {line.letter: _facts_of(line) for line in result.axes},
        "values": dict(located.values),
        "notes": list(notes),
    }
    return add_side_file(located.files, name, side), (*head, *notes)


def result_provenance(result: Result) -> dict[str, Any]:
    """Return what a side file says of the ``result`` that its numbers come from."""
    return {
        "method": result.method,
        "simulated": result.simulated,
        "item": result.circumstances.identity.title,
        "serial": result.circumstances.identity.serial,
        "verdict": result.verdict,
        "verdict_line": result.verdict_line,
    }


def _facts_of(line: AxisLine) -> dict[str, Any]:
    """Return an axis in plain types, SI."""
    found = zip(line.names, line.value, line.std, strict=True)
    return {
        "point_m": line.point.tolist(),
        "direction": line.direction.tolist(),
        "sense": line.sense,
        "found": {name: {"value": float(v), "std": float(std)} for name, v, std in found},
    }


def rounded_lengths(values: Sequence[float] | Floats, unit_m: float = MILLIMETRE) -> Floats:
    """Return lengths (n,), m, in ``unit_m``, rounded as they are written."""
    return np.round(np.asarray(values, dtype=np.float64) / unit_m, LENGTH_DECIMALS) + 0.0
