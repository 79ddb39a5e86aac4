"""Deviations from coordinates of stations alone, as a paper or another program states them.

Without the lengths it is not known how well the stations are determined. What is left is their
circle: by how much they leave it says how large noise of the stations and error motion of the
table are together, radially, and along the circle they are taken to be as large (see
:mod:`.uncertainty`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.adjust.closures import closures
from rotcal_ros.adjust.error_motion import WHITE
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.noise import UNTESTED, GlobalTest
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.protection import Protection, ordered
from rotcal_ros.foundation.results import ErrorMotion, Placement, Result, Zeros
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.solver.circle import (
    ABSORBED,
    TableMotion,
    bearing_slopes,
    check_sense,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.error_motion import error_motion_of, error_motion_spread
from rotcal_ros.methods.tracer.solver.solve import (
    METHOD,
    circle_details,
    doubt_closure,
    tangential_protection,
)


@dataclass(frozen=True, eq=False)
class StationProblem:
    """Places ``stations`` (m, 3) m of one tracer at ``table_angles`` (m,) rad.

    ``positions`` (m,) are their numbers in the plan. ``distances`` (m,) m from each to the first
    target are reported in the details, and used nowhere; empty: not known. ``error_motion_std``
    (m) as of a :class:`~.problem.TracerProblem`; ``significance`` of its test.
    """

    stations: Floats
    table_angles: Floats
    positions: Ints
    distances: Floats
    error_motion_std: float | None = None
    significance: float = 0.001


def solve(problem: StationProblem) -> Result:
    """Return the deviations ECC of the table from its stations; Eq. 18 to 36 of the paper.

    Counted and signed as by :func:`~.solve.solve`. Raises ObservabilityError for fewer than five
    stations, DataError or GeometryError where they do not follow the commanded angles, or lie on
    no circle.
    """
    m = len(problem.stations)
    if m <= ABSORBED + 1:
        raise ObservabilityError(
            f"{m} stations leave {max(m - ABSORBED, 0)} residuals of their circle, which have to "
            "show how well they are known: give at least 5, or the lengths"
        )
    motion = table_motion(problem.stations, problem.table_angles)
    check_sense(motion, problem.stations, problem.table_angles, problem.positions)
    stated, test = problem.error_motion_std or None, UNTESTED  # 0 m of places is no promise
    found, spectrum = error_motion_of(problem.stations, motion, np.zeros((3 * m, 3 * m)))
    if stated is not None:
        test = GlobalTest.of(float(motion.radial @ motion.radial) / stated**2, m - ABSORBED)
    contradicted = test.probability < problem.significance
    if stated is not None and not (contradicted and found.used > stated):
        found, spectrum = replace(found, used=stated), WHITE
    error_motion = replace(found, stated=stated)
    bearing = bearing_slopes(problem.stations, motion)
    spread = bearing.spread(error_motion_spread(motion, error_motion.used, spectrum))
    covariance, every = spread.from_first(), np.arange(m)
    std = np.sqrt(covariance.diagonal())
    closing = closures(
        problem.table_angles,
        motion.cumulative,
        LowRank.whole(covariance),
        problem.positions,
    )
    warnings = (
        *((_doubt(motion, error_motion),) if contradicted else ()),
        *(doubt_closure(c) for c in closing if c.open(problem.significance)),
    )
    return Result(
        method=METHOD,
        angles=problem.table_angles,
        deviations={"ECC": motion.cumulative},
        std={"ECC": std},
        covariance={"ECC": covariance},
        sigma0=test.sigma0,
        dof=m - ABSORBED,
        n_observations=m,
        verdict="suspect" if warnings else "ok",
        warnings=warnings,
        adjacent_deviations=motion.adjacent,
        adjacent_std=np.sqrt(spread.between(every[:-1], every[1:])),
        details={
            "variant": "stations",
            "station_ids": problem.positions,
            "stations": problem.stations,
            **({"distances": problem.distances} if problem.distances.size else {}),
            **circle_details(motion, problem.stations, problem.table_angles),
        },
        protections=_protections(motion, error_motion, closed=bool(closing)),
        zeros=Zeros("first angle"),
        budget={"error_motion": std},
        placement=Placement.upwards(
            motion.centre, motion.plane.normal, problem.positions, problem.stations
        ),
        error_motion=error_motion,
    )


def _doubt(motion: TableMotion, found: ErrorMotion) -> str:
    """Return what speaks against the stated error motion."""
    radial = np.sqrt((motion.radial**2).sum() / found.dof) / MICROMETRE
    return (
        f"the stations leave their circle by {radial:.2g} um radially ({found.dof} residuals), "
        f"more than the stated {(found.stated or 0.0) / MICROMETRE:.2g} um explain: "
        f"{found.used / MICROMETRE:.2g} um are used in its place"
    )


def _protections(
    motion: TableMotion, found: ErrorMotion, *, closed: bool
) -> tuple[Protection, ...]:
    """Return what protects a curve that rests on coordinates of stations alone."""
    stated = Protection("error motion", "bounded", "the stated error motion is inside U")
    shown = "noise of the stations and error motion together, as the circle's residuals show them"
    rests = Protection("error motion", "estimated", shown) if found.estimated else stated
    unknown = "coordinates of stations alone do not show it: solve the lengths, in their order"
    return ordered(
        (
            Protection("drift", "not protected", unknown),
            Protection("knock", "not protected", unknown),
            Protection("axis noise", "not protected", unknown),
            Protection(
                "repeatability",
                "not protected",
                "an angle that comes again has to agree, the others are reached once"
                if closed
                else "no angle was reached twice",
            ),
            Protection("refraction", "not protected", unknown),
            Protection("scale", "harmless", "an angle does not depend on the scale"),
            Protection("tilt", "harmless", "the angle is taken in the plane of the stations"),
            Protection(
                "gauge",
                "harmless",
                "no gauge is carried: the angle is counted on the circle of the stations",
            ),
            rests,
            tangential_protection(
                motion.radius,
                alike=", or noise of the stations along it that is larger than across,",
                within=None,
                shown="",
                untested="the angle",
            ),
        )
    )
