"""The rigid transform between two sets of matched points."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import GeometryError

MIN_ASPECT: Final = 0.01
"""Points whose extent across their longest direction is below this share lie "in a line"."""


def align(source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return rotation (..., 3, 3) and translation (..., 3) of least squares in closed form.

    ``target = rotation @ source + translation``; both sets are (..., n, 3) in metres. Never
    returns a reflection. Source: Arun, Huang and Blostein (1987), with the sign of Umeyama (1991).
    Whether the points determine the transform is not judged: see :func:`require_spread`.
    """
    share = 1.0 / source.shape[-2]
    source_mean = (share * source).sum(axis=-2, keepdims=True)
    target_mean = (share * target).sum(axis=-2, keepdims=True)
    correlation = np.swapaxes(share * (target - target_mean), -1, -2) @ (source - source_mean)
    u, _, vt = np.linalg.svd(correlation)
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    rotation: Floats = u @ vt
    shift = target_mean - source_mean @ np.swapaxes(rotation, -1, -2)
    return rotation, shift[..., 0, :]


def require_spread(points: Floats, what: str) -> None:
    """Raise GeometryError unless points (n, 3), n > 2, span a plane and so fix a rotation.

    ``what`` names the points in the message, for example "the nests shared by A and B".
    """
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[1] < MIN_ASPECT * extent[0] or extent[0] == 0.0:
        raise GeometryError(
            f"{what} lie in a line (within {extent[1] * 1e3:.2f} mm over "
            f"{extent[0] * 1e3:.0f} mm), so the rotation about that line is open; "
            "place at least one of them aside"
        )
