"""Deviations from coordinates of stations alone, as a paper or another program states them.

Without the lengths it is not known how well the stations are determined. What is left is their
circle: by how much they leave it says how large noise of the stations and error motion of the
table are together, radially, and along the circle they are taken to be as large (see
:mod:`.posed`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.closures import Closure, closures
from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.engine import Adjusted, adjust
from rotcal_ros.adjust.model import Model, linear
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.compact import difference_variance
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Protection, ordered
from rotcal_ros.foundation.results import ErrorMotion, Placement, Result, Zeros
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.tracer.solver.carried_lengths import UM, WORDS
from rotcal_ros.methods.tracer.solver.circle import (
    ABSORBED,
    TableMotion,
    check_sense,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.posed import ERROR_MOTION, with_error_motion
from rotcal_ros.methods.tracer.solver.reporting import tangential_protection
from rotcal_ros.methods.tracer.solver.solve import (
    METHOD,
    circle_details,
)

DIFFER_AT_ONE_ANGLE: Final = noted(
    "stations {0} and {1} stand at the same table angle but differ by {2:.3g} arcsec, expected 0 "
    "with a standard deviation of {3:.3g} arcsec: something moved or drifted during the run"
)
MORE_THAN_STATED: Final = noted(
    "the stations leave their circle by {0:.2g} um radially ({1} residuals), more than the "
    "stated {2:.2g} um explain: {3:.2g} um are used in its place"
)

EXACT: Final = 1e-10
"""Standard deviation (m) of coordinates whose noise counts as error motion."""


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
    stated = problem.error_motion_std or None  # 0 m of places is no promise
    sigma0, contradicted = 1.0, False
    if stated is not None:
        squares = float(motion.radial @ motion.radial) / stated**2
        sigma0 = float(np.sqrt(squares / (m - ABSORBED)))
        contradicted = chi2_sf(squares, m - ABSORBED) < problem.significance
    solved = adjust(model_of(motion, problem.table_angles, None if contradicted else stated))
    error_motion = _error_motion(motion, solved, stated)
    covariance, std, every = solved.covariance, solved.std, np.arange(m)
    closing = closures(problem.table_angles, motion.cumulative, covariance, problem.positions)
    warnings = (
        *((_doubt(motion, error_motion),) if contradicted else ()),
        *(_doubt_closure(c) for c in closing if c.open(problem.significance)),
    )
    return Result(
        method=METHOD,
        angles=problem.table_angles,
        deviations={"ECC": motion.cumulative},
        std={"ECC": std},
        covariance={"ECC": covariance},
        sigma0=sigma0,
        dof=m - ABSORBED,
        n_observations=m,
        verdict="suspect" if warnings else "ok",
        warnings=warnings,
        adjacent_deviations=motion.adjacent,
        adjacent_std=np.sqrt(difference_variance(covariance, every[:-1], every[1:])),
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


def model_of(
    motion: TableMotion, angles: Floats, stated: float | None, std: float = EXACT
) -> Model:
    """Return the model of the places of stations, m, which are known to ``std``, m.

    Outputs are their bearings from the first, at table ``angles`` (m,), rad. ``stated``: the error
    motion, m; None: it is not.
    """
    m = len(angles)
    across = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    along = np.column_stack([-across[:, 1], across[:, 0]])
    # bearings, radius, centre, and the error motion across and along
    own, none = np.eye(m), np.zeros((m, m))
    radial = np.hstack([none, np.ones((m, 1)), across, own, none])
    round_ = np.hstack([motion.radius * own, np.zeros((m, 1)), along, none, own])
    design = csr_array(np.concatenate([radial, round_]))
    blocks = {"bearing": m, "radius": 1, "centre": 2, "error motion": 2 * m}
    bearings = np.eye(m, design.shape[1])
    model = Model(
        blocks=blocks,
        observed=np.append(motion.radial, motion.radius * motion.cumulative),
        std=np.full(2 * m, std),
        equations=linear(design),
        outputs=bearings - bearings[0],
        words=WORDS,
        unit=UM,
        judged=np.zeros(2 * m, dtype=np.bool_),
    )
    column, each = np.arange(2 * m).reshape(m, 2), np.arange(m)[:, None]
    turning = np.zeros((2 * m, 2 * m))
    turning[each, column], turning[m + each, column] = across, along
    motions = csr_array(np.eye(2 * m, design.shape[1], m + 3))
    return with_error_motion(model, ERROR_MOTION, motions, stated, angles, csr_array(turning))


def _error_motion(motion: TableMotion, solved: Adjusted, stated: float | None) -> ErrorMotion:
    """Return what is stated of the error motion, or what the stations leave open of it."""
    dof = len(motion.radial) - ABSORBED
    likely = float(np.sqrt(motion.radial @ motion.radial / dof))
    used = float(solved.fit.std[-1])
    if solved.model.scatterings:
        used = float(np.sqrt(solved.fit.sizes[solved.model.scatterings[0]].squares.sum()))
    return ErrorMotion(stated, likely, max(likely, used), dof, used)


def _doubt(motion: TableMotion, found: ErrorMotion) -> Phrase:
    """Return what speaks against the stated error motion."""
    radial = np.sqrt((motion.radial**2).sum() / found.dof) / MICROMETRE
    return phrase(
        MORE_THAN_STATED,
        radial,
        found.dof,
        (found.stated or 0.0) / MICROMETRE,
        found.used / MICROMETRE,
    )


def _doubt_closure(closure: Closure) -> Phrase:
    """Return the sentence about a closure that is larger than its uncertainty allows."""
    return phrase(
        DIFFER_AT_ONE_ANGLE,
        closure.first,
        closure.last,
        closure.error / ARCSEC,
        closure.std / ARCSEC,
    )


def _protections(
    motion: TableMotion, found: ErrorMotion, *, closed: bool
) -> tuple[Protection, ...]:
    """Return what protects a curve that rests on coordinates of stations alone."""
    stated = Protection("error motion", "bounded", phrase("the stated error motion is inside U"))
    shown = phrase(
        "noise of the stations and error motion together, as the circle's residuals show them"
    )
    rests = Protection("error motion", "estimated", shown) if found.estimated else stated
    unknown = phrase(
        "coordinates of stations alone do not show it: solve the lengths, in their order"
    )
    return ordered(
        (
            Protection("drift", "not protected", unknown),
            Protection("knock", "not protected", unknown),
            Protection("axis noise", "not protected", unknown),
            Protection(
                "repeatability",
                "not protected",
                phrase("angles that are measured again have to agree; the others are reached once")
                if closed
                else phrase("no angle was reached twice"),
            ),
            Protection("refraction", "not protected", unknown),
            Protection("scale", "harmless", phrase("an angle does not depend on the scale")),
            Protection(
                "tilt", "harmless", phrase("the angle is taken in the plane of the stations")
            ),
            Protection(
                "gauge",
                "harmless",
                phrase("no gauge is carried: the angle is counted on the circle of the stations"),
            ),
            rests,
            tangential_protection(
                motion.radius,
                alike=phrase(", or noise of the stations along it that is larger than across,"),
                within=None,
                shown="",
                untested=phrase("the angle"),
            ),
        )
    )
