"""What a configuration says of the polygon method: groups ``plan`` and ``solver``."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import setting


@dataclass(frozen=True)
class PolygonPlanSettings:
    """The polygon, its mountings, and where the table stops: once for every face."""

    faces: int = setting(
        12, doc="number of faces of the polygon", minimum=3, maximum=144, first=True
    )
    first_faces: tuple[int, ...] = setting(
        (0, 1, 5),
        doc="face before the autocollimator at table position 0, by mounting",
        minimum=0,
        first=True,
    )
    table_start_deg: float = setting(0.0, doc="deg, table angle of position 0", first=True)
    closure: bool = setting(True, doc="measure position 0 again after a full turn")
    readings: int = setting(3, doc="readings at each position", minimum=1, maximum=1000)
    alignment_arcsec: float = setting(
        60.0, doc="arcsec, largest first reading of a mounting: else align again", minimum=0.1
    )


@dataclass(frozen=True)
class PolygonSolverSettings:
    """How sure a reading is, and what is known about the polygon."""

    sigma_arcsec: float = setting(
        0.05,
        doc="arcsec, standard deviation of a reading, the table's repeatability included",
        minimum=1e-6,
        first=True,
    )
    face_errors_arcsec: tuple[float, ...] = setting(
        (),
        doc="arcsec, certificate: how far each face is turned counter-clockwise; none: unknown",
        first=True,
    )
    face_std_arcsec: float = setting(
        0.05,
        doc="arcsec, standard uncertainty (k = 1) of the face errors of the certificate",
        minimum=1e-6,
        first=True,
    )
