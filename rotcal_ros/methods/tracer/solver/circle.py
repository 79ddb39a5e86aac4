"""From tracer stations to table angles: plane, circle, deviations.

Laser tracer paper, sections 3.2 to 3.4. Two kinds of deviation are kept apart everywhere:
*cumulative* (positioning) deviations are counted from the first station, *adjacent* (interval)
ones from the station before; the paper's Table 3 lists adjacent ones. Deviation = actual -
commanded, radians, counter-clockwise about the side of the plane normal that points along +z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.plane import Plane, circle_centre_jacobian, fit_circle, fit_plane
from rotcal_ros.geometry.rotations import wrap_angle

ABSORBED: Final = 3
"""Parameters of a circle that take up radial distances (centre, radius), and axial ones."""
LOST: Final = 0.1
"""Deviation (rad) beyond which the stations are not those of the commanded angles."""


@dataclass(frozen=True, slots=True)
class TableMotion:
    """How the table has carried the tracer through its m stations.

    ``centre`` (3,) is the circle's centre in space, ``in_plane`` (m, 2) are the stations,
    projected on the plane, seen from that centre in the plane's basis.
    ``cumulative`` (m,) and ``adjacent`` (m - 1,) are deviations in radians; ``cumulative[0]`` is
    zero. ``tilt`` is the angle between the plane normal and +z in radians.
    """

    plane: Plane
    centre: Floats
    radius: float
    in_plane: Floats
    cumulative: Floats
    adjacent: Floats
    tilt: float

    @property
    def radial(self) -> Floats:
        """Distances (m,) of the stations from the circle, positive outside."""
        return np.asarray(np.linalg.norm(self.in_plane, axis=1) - self.radius, dtype=np.float64)


def table_motion(stations: Floats, table_angles: Floats) -> TableMotion:
    """Return the deviations of the table from its ``stations`` (m, 3) at ``table_angles`` (m,).

    Plane and projection (Eq. 18-21), circle centre (Eq. 22-31), angles (Eq. 32-33).
    Slips of the paper done right here:

    * Eq. 22 fits the circle to X', Y', the shadow of the plane on the machine's xy-plane, which
      is an ellipse for a tilted axis. The circle is fitted in the plane itself.
    * Eq. 31: the plane's constant is e (Eq. 19); it is printed d, which is the name of a distance.
    * Eq. 32 takes the angle by arccos, which knows no sense of rotation, ends at 180 degrees and
      loses digits near 0; here it is the difference of two atan2.

    Raises GeometryError when the stations do not determine plane or circle, or when the axis
    is nearer to the xy-plane than to z.
    """
    plane = fit_plane(stations)
    tilt = axis_tilt(plane.normal)
    if tilt > np.pi / 4:
        raise GeometryError(
            f"the stations turn about an axis {np.degrees(tilt):.1f} deg away from +z; the table "
            "axis has to be near +z: turn the coordinates of the targets accordingly"
        )
    basis = plane.basis()
    flat = (stations - plane.centroid) @ basis.T
    circle = fit_circle(flat)
    in_plane = flat - circle.centre
    excess = np.arctan2(in_plane[:, 1], in_plane[:, 0]) - table_angles
    return TableMotion(
        plane=plane,
        centre=plane.centroid + circle.centre @ basis,
        radius=circle.radius,
        in_plane=in_plane,
        cumulative=wrap_angle(excess - excess[0]),
        adjacent=wrap_angle(np.diff(excess)),
        tilt=tilt,
    )


def from_first(bearings: Outputs) -> Outputs:
    """Return what all ``bearings`` differ from the first by; that one is exactly zero."""
    few, first = bearings.few.copy(), -bearings.few[:1].toarray()
    few.data[: few.indptr[1]] = 0.0
    others = (np.arange(len(bearings)) > 0).astype(np.float64)
    share = np.column_stack([bearings.share - bearings.share[0], others])
    return Outputs(few, np.vstack([bearings.common, first]), share)


def bearing_slopes(stations: Floats, motion: TableMotion) -> Outputs:
    """Return d bearing / d stations, (m, 3 m), up to one common turn of all bearings.

    Differences of rows are exact: those are all that deviations need. The chain runs through
    the plane's normal (first-order perturbation of the singular vector), the projection and the
    circle's centre. A bearing feels its own station, and all others by way of normal and centre.
    """
    m = len(stations)
    basis, normal = motion.plane.basis(), motion.plane.normal
    relative = stations - motion.plane.centroid
    flat, height = relative @ basis.T, relative @ normal
    # d normal, in the basis: (moments - lambda_3) dn = -sum(flat dz + height dflat)
    moments = flat.T @ flat - motion.plane.singular_values[2] ** 2 * np.eye(2)
    push = flat[:, :, None] * normal + height[:, None, None] * basis
    d_normal = -np.linalg.solve(moments, push).transpose(1, 0, 2)
    d_normal = d_normal.reshape(2, 3 * m)  # centring drops out: sums are zero
    # d flat_i / d station_j = basis (delta_ij - 1/m) - height_i dn_j; the mean is taken care of
    # by the circle's Jacobian, because bearings feel flat_i - centre only.
    centre = circle_centre_jacobian(flat)
    d_centre = (centre @ basis).reshape(2, 3 * m) - (centre.swapaxes(1, 2) @ height) @ d_normal
    arm = motion.in_plane
    tangent = np.stack([-arm[:, 1], arm[:, 0]], axis=1) / (arm**2).sum(axis=1)[:, None]
    common = np.hstack([-height[:, None] * tangent, -tangent])
    each = np.arange(3 * m + 1)
    few = csr_array(((tangent @ basis).ravel(), each[:-1], each[::3]), shape=(m, 3 * m))
    return Outputs(few, np.vstack([d_normal, d_centre]), common)


def axis_tilt(normal: Floats) -> float:
    """Return the angle alpha (rad) between a plane ``normal`` (3,) and the z axis (Eq. 35).

    By atan2 instead of the printed arccos: near zero a cosine keeps only half of the digits.
    """
    a, b, c = normal
    return float(np.arctan2(np.hypot(a, b), abs(c)))


def algorithm_error(angle: ArrayLike, tilt: float) -> Floats:
    """Return the error (rad) of reading ``angle`` on the xy-plane when the axis leans by ``tilt``.

    Eq. 36: atan(tan(theta) cos(alpha)) - theta, here with atan2, so that it also holds beyond 90
    degrees. Slip: the 0.4 arcsec printed in Eq. 38 does not follow from it; the paper's own normal
    (alpha = 5.2 arcsec) gives 3e-5 arcsec at 30 degrees. Deviations of :func:`table_motion` are
    free of this error, because they are taken in the fitted plane.
    """
    theta = np.asarray(angle, dtype=np.float64)
    return wrap_angle(np.arctan2(np.sin(theta) * np.cos(tilt), np.cos(theta)) - theta)


def printed_scatter(adjacent: Floats) -> float:
    """Return the paper's sigma of the ``adjacent`` deviations (q,), q > 1, in radians (Eq. 34).

    Half the root of sum(dtheta^2) / (q (q - 1)). Slip: printed with m, the number of stations,
    the equation gives 0.80 arcsec for the paper's data; its 0.9 needs q, the number of deviations.
    """
    q = len(adjacent)
    return 0.5 * float(np.sqrt((adjacent**2).sum() / (q * (q - 1))))


def contrast_count(stations: int) -> int:
    """Return how many distances from a stated circle, across and along, nothing takes up."""
    return 2 * max(stations - ABSORBED, 0)


def check_sense(motion: TableMotion, stations: Floats, commanded: Floats, positions: Ints) -> None:
    """Raise DataError when the stations (m, 3) at ``positions`` do not follow their angles."""
    worst = int(np.argmax(np.abs(motion.cumulative)))
    if abs(motion.cumulative[worst]) < LOST:
        return
    backward = table_motion(stations, -commanded)
    cure = "check the order of the stations and the start, step and unit of the table angles"
    if np.abs(backward.cumulative).max() < LOST:
        cure = (
            "they follow the angles with the opposite sign. Which way does the table turn, seen "
            "from +z, while its angle counts up? Clockwise: negate the table angles. "
            "Counter-clockwise: the frame of the targets is left-handed (an axis turned round, or "
            "two exchanged), which lengths alone cannot show"
        )
    off, order = motion.cumulative[worst] / DEGREE, commanded[worst] / DEGREE
    raise DataError(
        f"station {positions[worst]} stands at {(order + off) % 360.0:.4f} degrees where "
        f"{order:.4f} were commanded, {off:+.4f} degrees off: {cure}"
    )
