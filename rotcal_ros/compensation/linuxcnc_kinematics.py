"""The place of rotary axes for LinuxCNC: pins of ``xyzac-trt-kins`` and ``xyzbc-trt-kins``.

For a table that turns about C on one that tilts about A (or B) a point w of the work stands, with
both angles counter-clockwise, at

    r + d + Rx(A) (Rz(C) (w - r) - d)

r are the pins x-, y-, z-rot-point, and d the pins y-offset and z-offset (x-offset and z-offset for
B), to which tool-offset adds. So C stands at x-rot-point, y-rot-point; A lies at y-rot-point +
y-offset, z-rot-point + z-offset. Source: trtfuncs.c of LinuxCNC 2.9, and runs of the program.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from rotcal_ros.compensation.axis_location import DECIMALS, rounded_lengths
from rotcal_ros.compensation.controller import Located
from rotcal_ros.compensation.controller_files import fixed
from rotcal_ros.compensation.linuxcnc_machine import IniFile
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE, MILLIMETRE

KINEMATICS: Final = ("xyzac-trt-kins", "xyzbc-trt-kins")
SOURCE: Final = "LinuxCNC 2.9 source (trtfuncs.c) and runs of the program"
UNITS: Final = {
    **dict.fromkeys(("mm", "metric"), MILLIMETRE),
    **dict.fromkeys(("in", "inch", "imperial"), 25.4 * MILLIMETRE),
}
"""Words of [TRAJ] LINEAR_UNITS."""
HEIGHT_M: Final = 0.1


def kinematics_and_unit(ini: IniFile) -> tuple[str, float]:
    """Return kinematics and linear unit (m) of a machine; ConfigurationError for other ones."""
    name = ((ini.value("KINS", "KINEMATICS") or "").split() or [""])[0]
    if name not in KINEMATICS:
        raise ConfigurationError(
            f"{ini.path}: [KINS] KINEMATICS = {name or 'missing'} has no place for an axis, "
            f"expected {' or '.join(KINEMATICS)}; with other kinematics the work offset takes it"
        )
    unit = (ini.value("TRAJ", "LINEAR_UNITS") or "").lower()
    if unit not in UNITS:
        raise ConfigurationError(
            f"{ini.path}: [TRAJ] LINEAR_UNITS = {unit or 'missing'}, expected mm or inch"
        )
    return name, UNITS[unit]


def pins_in_hal(
    lines: Sequence[AxisLine], stem: str, head: Sequence[str], kinematics: str, unit_m: float
) -> Located:
    """Return the HAL lines that set the pins for ``lines``, in units of ``unit_m``.

    Raises ConfigurationError if the axis that tilts is not that of the kinematics.
    """
    table, *tilting = lines
    letter = kinematics[3].upper()
    across = "yx"["AB".index(letter)]
    if tilting and tilting[0].letter != letter:
        raise ConfigurationError(
            f"{kinematics} tilts about {letter}, and {tilting[0].letter} was measured: set "
            f"kinematics to {next(k for k in KINEMATICS if k != kinematics)}"
        )
    point = table.point
    values = {"x-rot-point": point[0], "y-rot-point": point[1]}
    if tilting:
        place = tilting[0].point
        offset = place["xyz".index(across)] - values[f"{across}-rot-point"]
        values |= {"z-rot-point": place[2], f"{across}-offset": offset, "z-offset": 0.0}
    written = dict(
        zip(values, rounded_lengths(list(values.values()), unit_m).tolist(), strict=True)
    )
    text = [*(f"# {line}" for line in head)]
    text += [f"setp {kinematics}.{pin} {fixed(x, DECIMALS)}" for pin, x in written.items()]
    notes = tuple(_left(table, tilting, letter, across))
    files = {f"{stem}.hal": "\n".join(text) + "\n"}
    return Located(files, {f"{kinematics}.{p}": x for p, x in written.items()}, SOURCE, notes)


def _left(table: AxisLine, tilting: Sequence[AxisLine], letter: str, across: str) -> Iterator[str]:
    """Yield in words what the pins cannot hold, of what is more than its uncertainty."""
    if not tilting:
        yield (
            f"{letter} was not measured: {across}-offset counts from {across}-rot-point; change "
            f"it by as much the other way, so that {letter} stays where it is"
        )
    for line in (table, *tilting):
        if line.sense < 0:
            yield (
                f"{line.letter} turns clockwise (plan.chain), and these kinematics turn the work "
                "counter-clockwise: reverse the sign of its joint, or of it in programs"
            )
        for name, angle, std in zip(line.names, line.value, line.std, strict=True):
            if name[0] not in "ABC" or abs(angle) < COVERAGE_FACTOR * std:
                continue
            if line is table and name[0] == letter:
                cure = f"the zero of {letter} can take it"
            else:
                cure = f"{HEIGHT_M / MILLIMETRE:g} mm away it makes "
                cure += f"{abs(angle) * HEIGHT_M / MICROMETRE:.2g} um"
            yield f"no pin holds {name} = {angle / ARCSEC:.3g} arcsec: {cure}"
