"""What protects a plane-mirror result against each effect that could spoil it, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf, normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER, Protection, ordered
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror.solver.drift import DriftCorrection
from rotcal_ros.methods.plane_mirror.solver.prepare import PreparedPoints, PreparedWay


@dataclass(frozen=True, eq=False)
class MirrorEvidence:
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


def protections(facts: MirrorEvidence) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    return ordered(
        (
            _drift(facts),
            _knock(facts),
            _noise(facts),
            _error_motion(facts),
            _repeatability(),
            _refraction(),
            _scale(facts),
            _tilt(facts),
            _gauge(),
            *_uneven_drift(facts),
        )
    )


def _drift(facts: MirrorEvidence) -> Protection:
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


def _uneven_drift(facts: MirrorEvidence) -> tuple[Protection, ...]:
    """Return the statement about a drift that is no straight line between rounds of nests.

    None where no drift is known at all: then everything is said there.
    """
    if facts.prepared.drift.open_stations:
        return ()
    stated = facts.prepared.problem.uneven_drift_std
    if facts.swings and stated > 0.0:
        why = (
            f"by the stated swing of the tracker's azimuth of {stated / ARCSEC:g} arcsec "
            "(uneven_drift_std_arcsec) about the straight line between rounds of nests"
        )
        return (Protection("uneven drift", "bounded", why),)
    error = float(ARCSEC / facts.std[1:].min())
    return (
        Protection(
            "uneven drift",
            "not protected",
            "what the tracker turns by between two rounds of nests and back again leaves no "
            f"trace; 1 arcsec of it moves a deviation by up to {error:.2g} standard "
            "uncertainties: let it settle, and measure the nests more often (plan.nests_every)",
        ),
    )


def _knock(facts: MirrorEvidence) -> Protection:
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
            f"the closure tells of {carried} that moved, but only nests that are measured again "
            "tell of a tracker knocked at its station",
        )
    found = normal_isf(problem.significance / 2.0) + normal_isf(1.0 - POWER)
    on_table = found * facts.closure_std / float(facts.std[1:].min())
    error = max(on_table, facts.correction.unseen_knock(facts.std))
    return Protection(
        "knock",
        "tested",
        f"the closure tells of {carried} that moved, nests measured again of the tracker",
        error,
    )


def _noise(facts: MirrorEvidence) -> Protection:
    if not facts.dof:
        return Protection("axis noise", "not protected", "nothing is measured twice")
    error = _hidden(facts.prepared.problem.significance, facts.dof)
    return Protection(
        "axis noise",
        "tested",
        "the residuals test the stated noise of the tracker and the slopes of the glass together; "
        "noise across the beam can hide behind an overstated one along it: the error is that of "
        "this case",
        error,
    )


def _error_motion(facts: MirrorEvidence) -> Protection:
    if facts.direct:
        return Protection(
            "error motion",
            "not protected",
            "a reflector on the table takes radial error motion for an angle, 0.7 arcsec per "
            "micrometre at 300 mm; the residuals show only what is along the radius",
        )
    return Protection(
        "error motion", "harmless", "a mirror that is moved without turning keeps its normal"
    )


def _repeatability() -> Protection:
    return Protection(
        "repeatability",
        "not protected",
        "the table arrives once at each position: its scatter from arrival to arrival is in the "
        "curve and not in the uncertainty",
    )


def _refraction() -> Protection:
    return Protection(
        "refraction",
        "not protected",
        "a gradient of 1 K/m across the beam bends it by about 0.1 arcsec for each metre, and no "
        "residual need show it",
    )


def _scale(facts: MirrorEvidence) -> Protection:
    what = "circles" if facts.direct else "lengths"
    return Protection(
        "scale", "harmless", f"a scale of the range changes all {what} alike and no angle"
    )


def _tilt(facts: MirrorEvidence) -> Protection:
    if facts.direct:
        return Protection(
            "tilt",
            "not protected",
            "a tilt of the table moves reflectors above its centre like radial error motion",
        )
    limit = facts.prepared.problem.tilt_std / ARCSEC
    return Protection(
        "tilt",
        "bounded",
        f"by the stated tilts of the table of {limit:g} arcsec (tilt_std_arcsec)",
    )


def _gauge() -> Protection:
    return Protection(
        "gauge", "harmless", "no method knows the zero: deviations count from the first position"
    )


def _hidden(significance: float, dof: int) -> float:
    """Return the error, in stated standard uncertainties, of noise across the beam once found.

    Found with POWER. The noise along the beam, a third of all coordinates, is taken as none at
    all, which hides most; the error is what comes on top of the stated noise.
    """
    found = float(chi2_isf(significance, dof)) / float(chi2_isf(POWER, dof))
    return float(np.sqrt(max(1.5 * found - 1.0, 0.0)))
