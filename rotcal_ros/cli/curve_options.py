"""Options of the verbs that compare curves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import ARCSEC

if TYPE_CHECKING:
    from rotcal_ros.curves.measured import MeasuredCurve

component_option: Final = click.option(
    "--component",
    type=click.Choice(COMPONENTS),
    default="ECC",
    show_default=True,
    help="The deviation to compare.",
)
align_option: Final = click.option(
    "--align-order",
    type=click.IntRange(0, 12),
    default=0,
    show_default=True,
    help="Harmonics removed besides the offset; 1 for radial deviations of different origins.",
)
reference_option: Final = click.option(
    "--reference-u",
    "reference_std",
    type=click.FloatRange(min=0.0),
    metavar="ARCSEC",
    callback=lambda _context, _option, given: None if given is None else given * ARCSEC,
    help="Standard uncertainty (k = 1) of reference tables that state none; 0: exact.",
)


def polygon_faces(polygon: Path | None, sources: Iterable[Path]) -> MeasuredCurve | None:
    """Return the calibrated faces in the file ``polygon``, if one is given.

    Raises UsageError where no reference table is among ``sources`` to take them off.
    """
    if polygon is None:
        return None
    from rotcal_ros.evaluation.reference import read_reference
    from rotcal_ros.foundation.tables import is_table
    from rotcal_ros.recordings.result_sources import read_text

    if not any(map(is_table, sources)):
        raise click.UsageError("--polygon belongs to a reference table, and none is given")
    return read_reference(read_text(polygon), str(polygon))
