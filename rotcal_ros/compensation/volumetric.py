"""All measured deviations, EXC .. ECC, for volumetric compensation: neutral, or for a controller.

Deviations, not corrections: actual - commanded, metres and radians, ISO 230-1 names. An absent
component has no column; one that was measured from both sides has three: the mean, forward and
reverse. Every number is written so that it is read back to the last bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from typing import Final

import numpy as np

from rotcal_ros.compensation import controller_files
from rotcal_ros.compensation.agreement import require_verified
from rotcal_ros.compensation.axis_location import result_provenance
from rotcal_ros.compensation.controller import ComponentErrors, Controller
from rotcal_ros.compensation.table import check_verdict
from rotcal_ros.compensation.writing import add_side_file, check_stem, choose_stem, side_file_facts
from rotcal_ros.foundation.arrays import Floats, std_of
from rotcal_ros.foundation.circumstances import NOTHING_MEASURED
from rotcal_ros.foundation.components import COMPONENTS, TRANSLATIONS, check_axis, unit_of
from rotcal_ros.foundation.curves.directional import refuse_lost_reversal
from rotcal_ros.foundation.curves.interpolation import curve_through
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.in_force import describe, is_table_hash
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import TURN

SIGN: Final = "deviation = actual - commanded; angles counter-clockwise about +z"
KIND: Final = "rotcal_volumetric"
LAST_DECIMAL: Final = 1e-10
"""A value (m, rad) may be rounded by this much in a file."""


def volumetric_files(result: Result, stem: str, axis: str = "C") -> dict[str, str]:
    """Return ``stem``.csv and ``stem``.json after both were read back and compared.

    Raises DataError unless the verdict is ok and every component has its uncertainty, and for runs
    from both sides of which only the mean is known.
    """
    check_stem(stem)
    check_axis(axis)
    check_verdict(result)
    refuse_lost_reversal(result)
    names = [name for name in COMPONENTS if name in result.deviations]
    if missing := [name for name in names if name not in result.std]:
        raise DataError(f"the {result.method} result has no uncertainty of {', '.join(missing)}")
    deviations, std = _columns(result, names)
    columns = {"angle_rad": result.angles}
    for name, values in deviations.items():
        columns[f"{name}_{_si_unit(name)}"] = values
        columns[f"u_{name}_{_si_unit(name)}"] = std[name]
    numbers = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in numbers.tolist())]
    on_top = [describe(result.measured_on)] if is_table_hash(result.measured_on) else []
    data = {
        "schema": 1,
        "kind": KIND,
        "axis": axis,
        "sign": SIGN,
        "units": {name: _si_unit(name) for name in deviations},
        "method": result.method,
        "simulated": result.simulated,
        "item": result.circumstances.identity.title,
        "serial": result.circumstances.identity.serial,
        "measured_on": result.measured_on,
        "verdict": result.verdict,
        "verdict_line": result.verdict_line,
        "not_protected": list(result.unprotected),
        "angles_rad": result.angles.tolist(),
        "deviations": {name: values.tolist() for name, values in deviations.items()},
        "std": {name: values.tolist() for name, values in std.items()},
        "warnings": [*result.warnings, *_one_sided(result, names), *on_top],
    }
    table, facts = "\n".join(lines) + "\n", json.dumps(data, indent=1) + "\n"
    found = controller_files.parse_numbers(
        f"{stem}.csv", table.splitlines()[1:], len(columns), ","
    )
    for file, same in (
        ("csv", np.array_equal(found, numbers)),
        ("json", json.loads(facts) == data),
    ):
        if not same:
            raise BagError(f"{stem}.{file}: read back, it differs from what was measured")
    return {f"{stem}.csv": table, f"{stem}.json": facts}


def prepare_volumetric(
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
    """Return the files that feed all measured deviations to a ``controller``, and what to know.

    They are read back, and applied as the control does, before they are returned. ``stem`` is the
    file name without extension (else axis, controller, "volumetric"), ``sources`` maps what the
    numbers come from to its SHA-256. Raises DataError unless the verdict is ok and the angles go
    round, ConfigurationError for a controller without a known form, for an axis other than C, and
    for what is not verified, unless ``accept_unverified``. Writes nothing.
    """
    _refuse(result, axis)
    names = [name for name in COMPONENTS if name in result.deviations]
    curves = {name: measured_curve(result, name) for name in names}
    if not all(curve.period for curve in curves.values()):
        raise DataError("a volumetric compensation repeats every turn: measure the full circle")
    angles = next(iter(curves.values())).angles
    errors = ComponentErrors(angles, {name: curve.deviation for name, curve in curves.items()})
    usual = f"{check_axis(axis)}_{controller_name}_volumetric"
    name = choose_stem(stem, usual, simulated=result.simulated)
    head = [SIGN, *([NOTHING_MEASURED] if result.simulated else [])]
    written = controller.write_components(errors, name, head)
    if not accept_unverified:
        require_verified(controller.facts.title, written.unverified)
    left = _left_between(errors, controller.read_components(written.files))
    absent = [name for name in COMPONENTS if name not in names]
    notes = [
        *(f"{n}: the control's lines leave up to {_shown(n, x)}" for n, x in left.items()),
        *([f"not measured, so 0 in the file: {', '.join(absent)}"] if absent else []),
        *_one_sided(result, names),
        *(f"{n} has both directions, the file their mean" for n in result.directions),
        *written.notes,
        *(f"not verified: {text}" for text in written.unverified),
    ]
    side = {
        **side_file_facts(written.files, now, sources),
        "kind": KIND,
        "controller": controller_name,
        "controller_title": controller.facts.title,
        "settings": asdict(controller),
        "source": written.source,
        **result_provenance(result),
        "sign": SIGN,
        "measured_on": result.measured_on,
        "rows": len(angles),
        "left": left,
        "notes": notes,
    }
    return add_side_file(written.files, name, side), tuple(notes)


def _refuse(result: Result, axis: str) -> None:
    check_verdict(result)
    refuse_lost_reversal(result)
    if is_table_hash(result.measured_on):
        raise DataError(
            f"{describe(result.measured_on)}: a volumetric compensation would replace what that "
            "table corrects; measure without a table"
        )
    if not axis.startswith("C"):
        raise ConfigurationError(
            f"axis {axis}: the deviations are those of an axis about Z, EXC .. ECC, and are not "
            "turned to the names of another one: give the table as axis C"
        )


def _left_between(errors: ComponentErrors, back: ComponentErrors) -> dict[str, float]:
    """Return how far lines through what was read are from the smooth curves (m, rad) at most.

    Raises BagError for a value that is not the measured one, to the last decimals of a file.
    """
    grid, left = np.linspace(0.0, TURN, 3600, endpoint=False), {}
    for name, values in errors.deviations.items():
        found = back.deviations[name]
        if len(found) != len(values) or np.max(np.abs(found - values)) > LAST_DECIMAL:
            raise BagError(f"{name}: read back, it differs from what was measured")
        smooth = curve_through(errors.angles, values, TURN)(grid)
        lines = np.interp(grid, back.angles, found, period=TURN)
        left[name] = float(np.max(np.abs(lines - smooth)))
    return left


def _shown(name: str, value: float) -> str:
    scale, unit = unit_of(name)
    return f"{value / scale:.2g} {unit}"


def _columns(result: Result, names: list[str]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return deviations and standard uncertainties (n,), then those of each direction."""
    deviations = {name: result.deviations[name] for name in names}
    std = {name: result.std[name] for name in names}
    for name, both in result.directions.items():
        if np.array_equal(both.angles, result.angles):
            deviations |= {f"{name}_forward": both.forward, f"{name}_reverse": both.reverse}
            own = np.split(std_of(both.covariance), 2)
            std[f"{name}_forward"], std[f"{name}_reverse"] = own
    return deviations, std


def _one_sided(result: Result, names: list[str]) -> list[str]:
    """Return in words how much of a known reversal is missing in the columns."""
    found = []
    for name, both in result.directions.items():
        if name in names and not np.array_equal(both.angles, result.angles):
            scale, unit = unit_of(name)
            found.append(
                f"{name} is the mean of both directions, since some angles were reached only from "
                f"one side: up to {np.max(np.abs(both.reversal)) / scale:.3g} {unit} of reversal "
                "are not in the columns"
            )
    return found


def _si_unit(column: str) -> str:
    return "m" if column[:3] in TRANSLATIONS else "rad"
