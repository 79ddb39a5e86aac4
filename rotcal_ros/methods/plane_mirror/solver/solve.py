"""The plane-mirror calibration: a frozen problem in, the angular deviations out.

:func:`solve` makes the result of one measurement, :func:`mirror_trials` prepares simulated ones
about it, of which a thousand are solved in one go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.closures import Closure, closures
from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.noise import GlobalTest
from rotcal_ros.adjust.reliability import hidden_noise
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.protection import POWER, Protection, ordered
from rotcal_ros.foundation.results import FreeDirection, Residuals, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.plane_mirror.solver import gathering
from rotcal_ros.methods.plane_mirror.solver.drift import DriftCorrection, swings
from rotcal_ros.methods.plane_mirror.solver.normals import image_response, incidence, tangent_frame
from rotcal_ros.methods.plane_mirror.solver.problem import WORDS, PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.readings import cones, islands
from rotcal_ros.methods.plane_mirror.solver.ways import (
    AdjustedCurve,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
    WayFit,
)

METHOD: Final = "plane_mirror"
UNTIED: Final = "table positions that share no reflector"
MAX_DEVIATION: Final = 1.0 * DEGREE
"""No rotary table is this wrong; a commanded angle or a nest is."""
_CHUNK: Final = 250  # trials at a time keep the arrays small enough for the cache


def solve(problem: PlaneMirrorProblem) -> Result:
    """Return the angular deviation ECC of the table at every position, with covariance.

    Deviations are actual - commanded, counter-clockwise about the axis whose sense the commanded
    angles give, and zero at the first position (no method knows that offset). The paper,
    Muralikrishnan et al., "A Method to Calibrate Angular Positioning Errors Using a Laser Tracker
    and a Plane Mirror", prints commanded - measured (equations 6 to 19): the opposite sign.
    Standard deviations follow from the stated noise; when the residuals contradict it they are
    scaled up by ``sigma0``, with a warning.

    Raises DataError, GeometryError (see :mod:`~rotcal_ros.methods.plane_mirror.solver.prepare`).
    """
    return solved(problem)[0]


def solved(problem: PlaneMirrorProblem) -> tuple[Result, Ints]:
    """Return :func:`solve` with the positions (n,) of the problem that the result has."""
    (screened, gathered, points), residuals = gathering.settled(problem), no_residuals(problem)
    prepared = screened.prepared
    curve, correction = _with_drift(prepared, prepared.curve(residuals))
    angles, deviations = prepared.angles, curve.deviations
    check_size(problem, angles, deviations)
    fit = curve.fit
    test = GlobalTest.of(fit.chi_square, fit.dof)
    covariance, warnings = _judge(test, curve, problem.significance)
    # To the noise come errors that may gather in one place, and drift that the nests cannot show.
    if (added := gathered.covariance()) is not None:
        covariance = covariance + added
    if points is not None:
        swung = points.response(swings(prepared.problem, prepared.drift))
        covariance = covariance + swung @ swung.T
    side = None if problem.upward is None else problem.upward[prepared.positions]
    repeats = closures(angles, deviations, LowRank.whole(covariance), np.arange(len(angles)), side)
    std, closure = _std(covariance), _whole_turn(repeats, angles)
    limits = engine.GatheringLimits(gathering.USUAL_SHARE, problem.significance)
    gathers = engine.doubts(gathered, limits, WORDS)
    warnings = [
        *screened.warnings,
        *gathers,
        *warnings,
        *correction.doubts(std),
        *differing(repeats, angles, problem.significance),
    ]
    closes = closure.get("closure_std_rad")
    facts = _Evidence(prepared, correction, std, fit.dof, closes, points is not None)
    again = [
        {"first": c.first, "second": c.last, "difference_rad": c.error, "std_rad": c.std}
        for c in repeats
    ]
    details = {**_details(prepared, curve), "repeats": again, **closure}
    if gathered.judgement is not None:
        details["gathering"] = engine.details(gathered, WORDS.elements)
    steps = np.diff(np.eye(len(angles)), axis=0)
    result = Result(
        method=METHOD,
        angles=angles,
        deviations={"ECC": deviations},
        std={"ECC": std},
        covariance={"ECC": covariance},
        sigma0=test.sigma0,
        dof=fit.dof,
        n_observations=len(problem.xyz),
        rejected=screened.rejected,
        verdict="suspect" if warnings else "ok",
        warnings=tuple(warnings),
        adjacent_deviations=np.diff(deviations),
        adjacent_std=_std(steps @ covariance @ steps.T),
        residuals=residuals,
        details={**details, **correction.details(std)},
        protections=ordered(
            (*_protections(facts), *gathering.protection(gathered, prepared, std))
        ),
    )
    return result.counted_from(*_zeros(prepared)), prepared.positions


def no_residuals(problem: PlaneMirrorProblem) -> Residuals:
    """Return residuals in which no row is used yet (all zero)."""
    n = len(problem.xyz)
    return Residuals(
        table_position=problem.position.copy(),
        target=problem.nest.copy(),
        residual=np.zeros(n),
        redundancy=np.zeros(n),
        test_value=np.zeros(n),
        used=np.zeros(n, dtype=np.bool_),
        std=np.sqrt(np.trace(problem.noise.covariance(problem.xyz), axis1=1, axis2=2) / 3.0),
        coordinates=3,
    )


def _with_drift(
    prepared: PreparedWay, curve: AdjustedCurve
) -> tuple[AdjustedCurve, DriftCorrection]:
    """Return the curve with the uncertainty of the drift in it, and what the drift did."""
    drift = prepared.drift
    correction = DriftCorrection.of(prepared.problem, drift, prepared.drift_response())
    if not drift.size:
        return curve, correction
    fit = curve.fit
    if not len(prepared.nests.row):  # else the nests are in the fit, with what the drift took
        fit = fit + sum((WayFit(s.chi_square, s.dof) for s in drift.stations), WayFit())
    return replace(curve, covariance=curve.covariance + correction.covariance, fit=fit), correction


def _zeros(prepared: PreparedWay) -> tuple[str, tuple[FreeDirection, ...]]:
    """Return what ECC counts from, and the offsets of positions that no reflector ties together.

    With a mirror all positions are tied: see :func:`~.readings.require_overlap`.
    """
    if not isinstance(prepared, PreparedPoints):
        return "first angle", ()
    seen = prepared.reflectors
    label, _ = islands(seen.position, seen.reflector, len(prepared.angles))
    free = tuple(
        FreeDirection(UNTIED, {"ECC": (label == own).astype(np.float64)})
        for own in range(1, int(label.max()) + 1)
    )
    return "first angle of each group" if free else "first angle", free


def _std(covariance: Floats) -> Floats:
    """Return standard deviations (n,); rounding may leave a variance of zero below it."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _details(prepared: PreparedWay, curve: AdjustedCurve) -> dict[str, Any]:
    """Return the method's own part of the result; SI, plain arrays and numbers."""
    return {
        "way": prepared.problem.way,
        **curve.fit.details,
        **_stations(prepared),
        **_normals(prepared),
        **({} if prepared.problem.upward is None else {"table_positions": prepared.positions}),
    }


def _judge(
    test: GlobalTest, curve: AdjustedCurve, significance: float
) -> tuple[Floats, list[str]]:
    """Return the covariance, and a warning where it could not be trusted as it is.

    It is scaled when the residuals are larger than the stated noise allows.
    """
    if curve.fit.dof == 0:
        return curve.covariance, ["nothing is measured twice: the noise could not be checked"]
    scale = test.enlargement(significance)
    if scale == 1.0:
        return curve.covariance, []
    text = (
        f"the residuals are {scale:.2f} times what the stated noise explains; the standard "
        "deviations are scaled by that: check tracker noise, nests and mirror"
    )
    return curve.covariance * scale**2, [text]


def _stations(prepared: PreparedWay) -> dict[str, Any]:
    """Return where the tracker stood, if the way brings its stations together."""
    poses = prepared.poses
    if not len(prepared.nests.row):
        return {}
    return {
        "stations": [
            {
                "station": prepared.problem.station_name(s),
                "position_m": poses.translation[s],
                "rotation": poses.rotation[s],
            }
            for s in range(len(poses.rotation))
        ]
    }


def _normals(prepared: PreparedWay) -> dict[str, Any]:
    """Return the mirror's normals and how steeply they were seen, if there is a mirror."""
    if not isinstance(prepared, PreparedNormals):
        return {}
    problem, pairs = prepared.problem, prepared.pairs
    normals = prepared.normals(problem.xyz)
    angle = incidence(problem.xyz, pairs, normals.normal)
    steepest = np.maximum.reduceat(angle, pairs.start)
    return {
        "incidence_limit_rad": problem.incidence_limit,
        "normals": [
            {
                "angle_rad": prepared.angles[pairs.position[g]],
                "station": problem.station_name(int(pairs.station[g])),
                "incidence_rad": steepest[g],
                "normal": normals.normal[g],
            }
            for g in range(pairs.n_groups)
        ],
    }


def check_size(problem: PlaneMirrorProblem, angles: Floats, deviations: Floats) -> None:
    """Refuse deviations that no table has, naming the worst position; ``angles`` (N,) rad."""
    worst = int(np.argmax(np.abs(deviations)))
    if not np.all(np.isfinite(deviations)) or abs(deviations[worst]) > MAX_DEVIATION:
        raise DataError(
            f"{problem.source}: the table position commanded to {angles[worst] / DEGREE:g} deg "
            f"comes out {deviations[worst] / DEGREE:.2f} deg off; no table is that wrong: "
            "reflector on the wrong nest, wrong position number, or wrong commanded angle; "
            "correct it"
        )


def differing(repeats: Sequence[Closure], angles: Floats, significance: float) -> list[str]:
    """Return a sentence about positions that differ, commanded to the same of ``angles`` (N,)."""
    return [
        f"positions commanded to {angles[c.first] / DEGREE:g} and {angles[c.last] / DEGREE:g} deg "
        f"differ by {c.error / ARCSEC:.2f} arcsec, expected within {2 * c.std / ARCSEC:.2f}: the "
        "table does not repeat, or mirror or tracker moved"
        for c in repeats
        if c.open(significance)
    ]


def _whole_turn(repeats: Sequence[Closure], angles: Floats) -> dict[str, float]:
    """Return how far the table is from its first place after a whole turn, if it was measured."""
    for c in repeats:
        if abs(turned := angles[c.last] - angles[c.first]) > np.pi:
            return {
                "closure_rad": float(np.sign(turned)) * c.error,
                "closure_std_rad": c.std,
            }
    return {}


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the statements rest on: the prepared data, what the drift did, and the result.

    ``std`` (N,) in rad; ``dof`` degrees of freedom of the residuals; ``closure_std`` (rad) of the
    first position measured again after a whole turn, None where it was not. ``swings``: whether
    the uncertainty holds the stated swings.
    """

    prepared: PreparedWay
    correction: DriftCorrection
    std: Floats
    dof: int
    closure_std: float | None
    swings: bool

    @property
    def direct(self) -> bool:
        """Whether the table carried reflectors and no mirror."""
        return isinstance(self.prepared, PreparedPoints)


def _protections(facts: _Evidence) -> Iterator[Protection]:
    """Yield a statement about every effect but what gathers in one place."""
    yield _drift(facts)
    yield _knock(facts)
    yield _noise(facts)
    yield from _carried(facts)
    yield Protection(
        "repeatability",
        "not protected",
        "the table arrives once at each position: its scatter from arrival to arrival is in the "
        "curve and not in the uncertainty",
    )
    yield Protection(
        "refraction",
        "not protected",
        "a gradient of 1 K/m across the beam bends it by about 0.1 arcsec for each metre, and no "
        "residual need show it",
    )
    zero = "no method knows the zero: deviations count from the first position"
    yield Protection("gauge", "harmless", zero)
    if not facts.prepared.drift.open_stations:  # else everything is said of the drift
        yield _uneven_drift(facts)


def _carried(facts: _Evidence) -> Iterator[Protection]:
    """Yield what depends on what the table carries: reflectors, or a mirror."""
    what = "circles" if facts.direct else "lengths"
    scale = f"a scale of the range changes all {what} alike and no angle"
    yield Protection("scale", "harmless", scale)
    if facts.direct:
        yield Protection(
            "error motion",
            "not protected",
            "a reflector on the table takes radial error motion for an angle, 0.7 arcsec per "
            "micrometre at 300 mm; the residuals show only what is along the radius",
        )
        lean = "a tilt of the table moves reflectors above its centre like radial error motion"
        yield Protection("tilt", "not protected", lean)
        return
    motion = "a mirror that is moved without turning keeps its normal"
    yield Protection("error motion", "harmless", motion)
    limit = facts.prepared.problem.tilt_std / ARCSEC
    stated = f"by the stated tilts of the table of {limit:g} arcsec (tilt_std_arcsec)"
    yield Protection("tilt", "bounded", stated)


def _drift(facts: _Evidence) -> Protection:
    drift, problem = facts.prepared.drift, facts.prepared.problem
    if drift.open_stations:
        names = ", ".join(problem.station_name(s) for s in drift.open_stations)
        return Protection(
            "drift",
            "not protected",
            f"the nests were not measured again before the tracker left station {names}, so what "
            "it turned by while it stood there is in the deviations",
        )
    return Protection(
        "drift",
        "estimated",
        "nests measured again show turns, shifts and range of the tracker at each station, linear "
        "in time between rounds of nests; a part that moves a deviation by more than one standard "
        "uncertainty makes the result suspect",
    )


def _uneven_drift(facts: _Evidence) -> Protection:
    """Return the statement about a drift that is no straight line between rounds of nests."""
    stated = facts.prepared.problem.uneven_drift_std
    if facts.swings and stated > 0.0:
        return Protection(
            "uneven drift",
            "bounded",
            f"by the stated swing of the tracker's azimuth of {stated / ARCSEC:g} arcsec "
            "(uneven_drift_std_arcsec) about the straight line between rounds of nests",
        )
    error = float(ARCSEC / facts.std[1:].min())
    return Protection(
        "uneven drift",
        "not protected",
        "what the tracker turns by between two rounds of nests and back again leaves no "
        f"trace; 1 arcsec of it moves a deviation by up to {error:.2g} standard "
        "uncertainties: let it settle, and measure the nests more often (plan.nests_every)",
    )


def _knock(facts: _Evidence) -> Protection:
    problem = facts.prepared.problem
    carried = "a reflector" if facts.direct else "a mirror"
    if facts.closure_std is None:
        return Protection(
            "knock",
            "not protected",
            f"no position was measured again after a whole turn: {carried} that moved on the "
            "table turns all positions after it without a trace",
        )
    if facts.prepared.drift.open_stations:
        return Protection(
            "knock",
            "not protected",
            f"the closure shows {carried} that moved, but only nests that are measured again "
            "show a tracker knocked at its station",
        )
    found = normal_isf(problem.significance / 2.0) + normal_isf(1.0 - POWER)
    on_table = found * facts.closure_std / float(facts.std[1:].min())
    error = max(on_table, facts.correction.unseen_knock(facts.std))
    return Protection(
        "knock",
        "tested",
        f"the closure shows {carried} that moved, nests measured again show the tracker",
        error,
    )


def _noise(facts: _Evidence) -> Protection:
    if not facts.dof:
        return Protection("axis noise", "not protected", "nothing is measured twice")
    # No noise at all along the beam, a third of all coordinates, hides most of that across it.
    error = hidden_noise(facts.prepared.problem.significance, facts.dof, 1.5)
    return Protection(
        "axis noise",
        "tested",
        "the residuals test the stated noise of the tracker and the slopes of the glass together; "
        "noise across the beam can hide behind an overstated one along it: the error is that of "
        "this case",
        error,
    )


@dataclass(frozen=True)
class MirrorTrials:
    """Draws measurements like the given one and solves them; made by :func:`mirror_trials`.

    ``factor`` (n, 3, 3) are Cholesky factors of the points' covariances, ``tilt`` (2 N, 3 n) the
    movement of all coordinates per tilt (rad) of the table across and along the normal, ``swing``
    (K, 3 n) the same per standard deviation of the tracker's :func:`~.drift.swings`.
    """

    prepared: PreparedWay
    factor: Floats
    tilt: Floats
    swing: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the deviations (count, N) in rad of ``count`` simulated measurements."""
        parts = [
            self.prepared.estimate(self.draw(rng, min(_CHUNK, count - done)))
            for done in range(0, count, _CHUNK)
        ]
        return np.concatenate(parts)

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Return points (count, n, 3): the measured ones with fresh noise and table tilts."""
        xyz = self.prepared.problem.xyz
        noise = rng.standard_normal((count, *xyz.shape))
        tilts = self.prepared.problem.tilt_std * rng.standard_normal((count, len(self.tilt)))
        points: Floats = xyz + (self.factor @ noise[..., None])[..., 0]
        points += (tilts @ self.tilt).reshape(points.shape)
        if len(self.swing):
            amplitudes = rng.standard_normal((count, len(self.swing)))
            points += (amplitudes @ self.swing).reshape(points.shape)
        return points


def mirror_trials(problem: PlaneMirrorProblem) -> MirrorTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    prepared = gathering.settled(problem).screened.prepared
    swing = swings(prepared.problem, prepared.drift).reshape(problem.xyz.size, -1).T
    covariance = problem.noise.covariance(problem.xyz)
    if isinstance(prepared, PreparedPoints):
        none = np.zeros((0, problem.xyz.size))
        return MirrorTrials(prepared, _factor(covariance), none, none)
    pairs, normals = prepared.pairs, prepared.normals(problem.xyz)
    response = image_response(
        problem.xyz[pairs.direct],
        problem.xyz[pairs.mirrored],
        normals.normal[pairs.group],
        normals.offset[pairs.group],
    )
    # The glass is not flat: it gives each mirrored point a normal of its own.
    slope = problem.noise.mirror_slope_std * response
    covariance[pairs.mirrored] += slope @ np.swapaxes(slope, 1, 2)
    axes, height = cones(prepared.poses.turned(normals.normal, pairs.station), prepared.sets)
    axes = (axes[:, None] @ prepared.poses.rotation[pairs.station])[
        :, 0
    ]  # as each station sees it
    t, b = tangent_frame(normals.normal, axes)
    tilt = np.zeros((len(prepared.angles), 2, *problem.xyz.shape))
    # A tilt of the table across the normal moves it along b; one about the normal's own horizontal
    # direction moves it along t, by sin(beta) of the tilt.
    for which, change in enumerate((b, height * t)):
        moved = (response @ change[pairs.group][..., None])[..., 0]
        tilt[pairs.position[pairs.group], which, pairs.mirrored] = moved
    tilt = tilt.reshape(-1, problem.xyz.size)
    return MirrorTrials(prepared, _factor(covariance), tilt, swing)


def _factor(covariance: Floats) -> Floats:
    """Return the Cholesky factors of covariances (n, 3, 3)."""
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
