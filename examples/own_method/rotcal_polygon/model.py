"""What a polygon and an autocollimator measure, for the engine: nothing else is about polygons.

    reading = t[position] + f[face] + o[mounting] + noise

All angles are radians, counter-clockwise about the table axis positive: ``t`` is the table's
deviation (actual - commanded), ``f`` by how much a face's normal is turned from its nominal
direction, ``o`` how the person placed the polygon. Faces are numbered in the order in which they
come to the autocollimator while the table angle increases, so that mounting ``m`` shows face
``(position + first_faces[m]) mod N``.
"""

from __future__ import annotations

from math import gcd
from typing import Final

import numpy as np

from rotcal_polygon.settings import PolygonPlanSettings, PolygonSolverSettings
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Grouping,
    Model,
    from_first,
    from_mean,
    indicators,
    instrument_effects,
    linear,
)
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.readings import Readings

LARGEST: Final = 10.0 * ARCSEC
"""A drift or a shift of this size nobody would overlook."""
FACE_ERROR: Final = "face error"
"""What the model tells beside the table's deviations: from their mean, where they are unknown."""


def separable(faces: int, first_faces: tuple[int, ...]) -> bool:
    """Whether mountings that begin with ``first_faces`` separate face errors from the table's."""
    return gcd(faces, *(face - first_faces[0] for face in first_faces)) == 1


def model_of(plan: PolygonPlanSettings, solver: PolygonSolverSettings, read: Readings) -> Model:
    """Return unknowns, readings and what could spoil them; position N is position 0 again.

    With one mounting and no certificate the polygon is taken for perfect. A certificate is known
    beforehand, from a zero of its own: one more mounting.
    """
    n, certificate = plan.faces, np.array(solver.face_errors_arcsec) * ARCSEC
    position, face, mounting, when = read.position % n, read.target, read.station, read.when
    certified, several = len(certificate) > 0, len(plan.first_faces) > 1
    blocks = {
        "table position": n,
        "face": n if several or certified else 0,
        "mounting": int(mounting.max()) + 1 + certified,
    }
    sizes = blocks.values()
    model = Model(
        blocks=blocks,
        observed=read.value,
        std=np.full(len(when), solver.sigma_arcsec * ARCSEC),
        equations=linear(indicators(*zip((position, face, mounting), sizes, strict=True))),
        outputs=from_first(blocks, "table position"),
        also={FACE_ERROR: from_mean(blocks, "face")} if blocks["face"] else {},
        words=Words(
            "readings", "a draught or a person", "in the line of sight", "in its line of sight"
        ),
        components=("the readings",),
        groupings=(
            Grouping("mounting", mounting, along=when),
            Grouping("face", face),
            Grouping("position", position),
        ),
        effects=instrument_effects(
            "the autocollimator", mounting, when, LARGEST, moved="polygon or autocollimator"
        ),
    )
    if not certified:
        return model
    columns = np.full(n, -1), np.arange(n), np.full(n, blocks["mounting"] - 1)
    rows = indicators(*zip(columns, sizes, strict=True))
    std = solver.face_std_arcsec * ARCSEC
    return model.knowing("the certificate", rows, certificate, std)
