"""ISG kernel and Beckhoff TwinCAT CNC: a parameter file of the volumetric compensation (ISG_CSV).

A header with the argument ``C`` (degrees) and the component errors EXC .. ECC of ISO 230, then one
record a line: millimetres and radians; comments begin with ``//``. Linear between the records
(GRID). Source: ``SOURCE``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from rotcal_ros.compensation.controller import ComponentErrors, Volumetric
from rotcal_ros.compensation.controller_files import fixed, only_file, parse_numbers
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, TRANSLATIONS
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE

ARGUMENT: Final = "C"
PLACES: Final = 6
DECIMALS: Final = 10
SOURCE: Final = (
    "ISG kernel FCT-C26 and Beckhoff TF5280: 296429067 (ISG CSV), 296426379 (units), 296423819 "
    "(parameters), 296433163 (interpolation), 1218769547 (activation); P-VOLC-00001 .. 00015"
)
UNVERIFIED: Final = (
    "that the parameters are deviations, actual - commanded, as ISO 230 has them: a page names "
    "'negate' (P-VOLC-00009) for the other sign",
    "the place that EXC, EYC and EZC hold for: it has to be that of the measurement",
)
NOTES: Final = (
    "switch lr_param.ssfk of the axis off (P-AXIS-00175), or its positioning is corrected twice",
    "vol_comp[i].max_records has to be at least the number of records",
    "switch on: name the list in vol_comp[i].file_name, then #VOLCOMP ON [ID0], axes homed",
)


def write(errors: ComponentErrors, stem: str, head: Sequence[str], axis_number: int) -> Volumetric:
    """Return the parameter file, closed with a record at 360 degrees, and lines that name it."""
    n = len(errors.angles)
    columns = [np.append(errors.angles, errors.angles[0] + 2.0 * np.pi) / DEGREE]
    for name in COMPONENTS:
        values = np.asarray(errors.deviations.get(name, np.zeros(n)), dtype=np.float64)
        unit = MILLIMETRE if name in TRANSLATIONS else 1.0
        columns.append(np.append(values, values[0]) / unit)
    lines = [
        " ".join([fixed(row[0], PLACES), *(fixed(x, DECIMALS) for x in row[1:])])
        for row in np.column_stack(columns)
    ]
    text = "\n".join([*(f"// {x}" for x in head), " ".join([ARGUMENT, *COMPONENTS]), *lines])
    configuration = [
        *([f"{ARGUMENT} {axis_number}"] if axis_number else []),
        "interpolation GRID",
        "enable_splicing 0",
        f"file[0] {stem}.csv",
        "file_format[0] ISG_CSV",
    ]
    files = {f"{stem}.csv": text + "\n", f"{stem}.lis": "\n".join(configuration) + "\n"}
    return Volumetric(files, SOURCE, NOTES, UNVERIFIED)


def parameters(name: str, text: str) -> dict[str, Floats]:
    """Return the columns (n,) of one block by their names, as they are in the file.

    Raises BagError for a record that does not fit the header, and for a second block (``#``).
    """
    lines = [line.split("//")[0].strip() for line in text.splitlines()]
    head, *records = [line for line in lines if line] or [""]
    names = head.split()
    if len(names) < 2 or any(line.startswith("#") for line in lines):
        raise BagError(f"{name}: expected one block, an argument and parameters in its header")
    data = parse_numbers(name, records, len(names), None)
    return dict(zip(names, data.T, strict=True))


def read(files: Mapping[str, str]) -> ComponentErrors:
    """Return the component errors of the file; BagError unless they close after a turn."""
    name, text = only_file(files, ".csv")
    columns = parameters(name, text)
    if list(columns) != [ARGUMENT, *COMPONENTS]:
        raise BagError(
            f"{name}: columns {' '.join(columns)}, expected {ARGUMENT} {' '.join(COMPONENTS)}"
        )
    angles = columns.pop(ARGUMENT)
    ends = [abs(values[-1] - values[0]) > 0.0 for values in columns.values()]
    turn = abs(angles[-1] - angles[0] - 360.0) > 10.0**-PLACES if len(angles) > 2 else True
    if turn or any(ends) or np.any(np.diff(angles) <= 0.0):
        raise BagError(f"{name}: expected records that ascend over 360 deg and close there")
    return ComponentErrors(
        angles[:-1] * DEGREE,
        {
            parameter: values[:-1] * (MILLIMETRE if parameter in TRANSLATIONS else 1.0)
            for parameter, values in columns.items()
        },
    )
