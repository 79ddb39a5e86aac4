"""What it tells of stations that a table carries them round a circle.

Stated is by how much stations leave one circle about the table's axis, radially and along the
axis. Its centre, radius and axis are unknown: of the m radial and m axial distances as many as
m - 3 contrasts each are left. To first order the angles do not feel these, so that the statement
says nothing of an error along the circle (see :mod:`.error_motion`); what it saves is lengths, for
the place of each station across its circle.

The contrasts are observations, like the machine's coordinates: zero, with the stated standard
deviation. So the lengths can contradict them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.plane import fit_circle, fit_plane

ABSORBED: Final = 3
"""Parameters of a circle that take up radial distances (centre, radius), and axial ones."""
FELT: Final = 1e-6
"""Share of a contrast that the lengths have to tell for it to be a test."""


class CircleContrasts(NamedTuple):
    """``value`` (c,): what no circle takes up of the stations' radial and axial distances, m.

    ``slope`` (c, 3 m): its derivative by the stations. First half radial, second half axial;
    c = 2 (m - 3).
    """

    value: Floats
    slope: Floats


def contrast_count(stations: int) -> int:
    """Return the number of contrasts of so many ``stations``."""
    return 2 * max(stations - ABSORBED, 0)


def circle_contrasts(stations: Floats) -> CircleContrasts:
    """Return the contrasts of ``stations`` (m, 3), m, about the circle that fits them best.

    Raises GeometryError when they determine no circle.
    """
    m = len(stations)
    if contrast_count(m) == 0:
        return CircleContrasts(np.zeros(0), np.zeros((0, 3 * m)))
    plane = fit_plane(stations)
    basis = plane.basis()
    flat = (stations - plane.centroid) @ basis.T
    circle = fit_circle(flat)
    in_plane = flat - circle.centre
    reach = np.linalg.norm(in_plane, axis=1)
    outward, ones = in_plane / reach[:, None], np.ones(m)
    values, slopes = [], []
    for absorbed, direction, off in (
        (np.column_stack([outward, ones]), outward @ basis, reach - circle.radius),
        (
            np.column_stack([in_plane, ones]),
            np.tile(plane.normal, (m, 1)),
            plane.distances(stations),
        ),
    ):
        free = np.linalg.qr(absorbed, mode="complete")[0][:, ABSORBED:]
        values.append(free.T @ off)
        slopes.append((free.T[:, :, None] * direction).reshape(m - ABSORBED, 3 * m))
    return CircleContrasts(np.concatenate(values), np.vstack(slopes))


@dataclass(frozen=True, eq=False)
class Unprejudiced:
    """What the lengths alone say of values that had a prior.

    ``seen`` (k,) are independent of each other, with the variances ``noise`` (k,), m^2. ``basis``
    (c, k) takes adjusted values (c,) to them; k <= c, for some the lengths may not tell at all.
    ``redundancy``: share of the prior's observations that the lengths check, 0 to 1.
    """

    seen: Floats
    noise: Floats
    basis: Floats
    redundancy: float


def without_prior(value: Floats, covariance: Floats, std: float) -> Unprejudiced:
    """Return what adjusted values (c,) say without their prior, zero with ``std`` (m) each.

    ``covariance`` (c, c) of the adjusted values, m^2: with r = 1 - covariance / std^2 the share
    of each that the lengths tell, the adjusted value is r times what they say.
    """
    left, axes = np.linalg.eigh(covariance / std**2)
    share = 1.0 - left
    felt = share > FELT
    share, left, axes = share[felt], np.maximum(left[felt], 0.0), axes[:, felt]
    basis = axes / share
    redundancy = float(share.sum()) / max(len(value), 1)
    return Unprejudiced(value @ basis, std**2 * left / share, basis, redundancy)
