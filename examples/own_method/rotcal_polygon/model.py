"""What a polygon and an autocollimator measure, for the engine: nothing else is about polygons.

    reading = t[position] + f[face] + o[mounting] + noise

All angles are radians, counter-clockwise about the table axis positive: ``t`` is the table's
deviation (actual - commanded), ``f`` by how much a face's normal is turned from its nominal
direction, ``o`` how the person placed the polygon. Faces are numbered in the order in which they
come to the autocollimator while the table angle increases, so that mounting ``m`` shows face
``(position + first_faces[m]) mod N``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import (
    Disturbing,
    Grouping,
    Model,
    Unit,
    drifts,
    indicators,
    knocks,
    linear,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import ARCSEC

LARGEST = 10.0 * ARCSEC
"""A drift or a shift of this size nobody would overlook."""


@dataclass(frozen=True, eq=False)
class PolygonReadings:
    """Readings (n,) rad with the standard deviation ``sigma``, in the order in which they came.

    ``certificate`` (N,) rad are known face errors, each with standard uncertainty
    ``certificate_std``. Without ``unknown_faces`` the polygon is taken for perfect.
    """

    faces: int
    position: Ints
    face: Ints
    mounting: Ints
    reading: Floats
    sigma: float
    certificate: Floats | None = None
    certificate_std: float = 0.0
    unknown_faces: bool = True


def separable(faces: int, first_faces: tuple[int, ...]) -> bool:
    """Whether mountings that begin with ``first_faces`` separate face errors from the table's."""
    return gcd(faces, *(face - first_faces[0] for face in first_faces)) == 1


def model_of(readings: PolygonReadings) -> Model:
    """Return unknowns, observations and what could spoil them; outputs: ECC from position 0.

    The certificate's values are observations, too, with a zero of their own: one more mounting.
    """
    r, n, count = readings, readings.faces, len(readings.reading)
    known = np.zeros(0) if r.certificate is None else r.certificate
    faces, of, none = (n if r.unknown_faces else 0), len(known), np.full(len(known), -1)
    mounting = np.append(r.mounting, np.full(of, r.mounting.max() + 1))
    position, face = np.append(r.position, none), np.append(r.face, np.arange(of))
    blocks = {"table position": n, "face": faces, "mounting": int(mounting.max()) + 1}
    design = indicators(*zip((position, face, mounting), blocks.values(), strict=True))
    run, when = np.append(r.mounting, none), np.arange(count + of, dtype=np.float64)
    outputs = np.eye(n, design.shape[1])
    outputs[:, 0] -= 1.0
    return Model(
        blocks=blocks,
        observed=np.append(r.reading, known),
        std=np.append(np.full(count, r.sigma), np.full(of, r.certificate_std)),
        equations=linear(design),
        outputs=outputs,
        words=Words(
            "readings", "a draught or a person", "in the line of sight", "in its line of sight"
        ),
        free=_zeros_of_all(n, faces, design.shape[1], bool(of)),
        components=("the readings", "the certificate")[: 1 + bool(of)],
        component=(when >= count).astype(np.int64),
        judged=when < count,
        groupings=(
            Grouping("mounting", run, along=when),
            Grouping("face", np.append(r.face, none)),
            Grouping("position", position),
        ),
        effects=(
            Disturbing("drift", "the autocollimator drifts", drifts(run, when), LARGEST),
            Disturbing(
                "knock", "polygon or autocollimator moved", knocks(run, when),
                LARGEST, family=True,
            ),
            Disturbing(
                "scale", "the autocollimator's scale is wrong",
                lambda read: np.where(when < count, read, 0.0)[:, None], 0.1, Unit("%", 0.01),
            ),
        ),
        row_name=lambda row: (
            f"mounting {run[row]}, position {position[row]}"
            if row < count
            else f"the certificate of face {row - count}"
        ),
    )  # fmt: skip


def _zeros_of_all(n: int, faces: int, unknowns: int, certified: bool) -> Floats:
    """Return what no reading tells: the zero of all positions, and that of all faces."""
    free = np.zeros((unknowns, 1 + bool(faces)))
    free[:n, 0], free[n + faces : unknowns - certified, 0] = 1.0, -1.0
    if faces:
        free[n : n + faces, 1], free[n + faces :, 1] = 1.0, -1.0
    return free


def face_errors(found: Adjusted, n: int) -> tuple[Floats, Floats]:
    """Return the errors (n,) of the faces from their mean, and their standard uncertainties."""
    from_mean = np.zeros((n, found.model.size[1]))
    from_mean[:, n : 2 * n] = np.eye(n) - 1.0 / n
    variance = found.fit.covariance_of(from_mean).diagonal()
    errors = from_mean @ found.fit.x[: from_mean.shape[1]]
    return errors, found.scale * np.sqrt(variance)
