"""What the drift of the tracker does to the deviations: their uncertainty, and the verdict.

Two rounds of nests show that the frame moved, not how: slowly, or by a knock. The correction
takes it as linear, and a knock would leave up to KNOCK times what it moved. So a correction that
is large makes a result suspect, and more rounds of nests make each part of it small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.plane_mirror.solver.drift import N_PARTS, StationDrift
from rotcal_ros.methods.plane_mirror.solver.outcomes import AdjustedCurve
from rotcal_ros.methods.plane_mirror.solver.prepare import Prepared, PreparedWay

LARGE: Final = 1.0
"""A part of the correction may move a deviation by so many of its standard uncertainties."""
KNOCK: Final = 4.0
"""A knock leaves up to this many times what the correction moved, found by simulation."""


@dataclass(frozen=True, eq=False)
class DriftCorrection:
    """The correction of K parts of the drift, each of one station from knot to knot.

    ``moved`` (K, N) is what each part did to the deviations in rad, ``noise`` (K, N) the standard
    uncertainty of that, ``covariance`` (N, N) what all parts add to that of the deviations.
    """

    moved: Floats
    noise: Floats
    covariance: Floats

    def shares(self, std: Floats) -> tuple[Floats, Floats]:
        """Return what each part moved (K, N), and its noise, in standard uncertainties (N,)."""
        scale = np.where(std > 0.0, std, np.inf)
        return np.abs(self.moved) / scale, self.noise / scale


def correct(
    prepared: PreparedWay, outcome: AdjustedCurve
) -> tuple[AdjustedCurve, DriftCorrection]:
    """Return the outcome with the uncertainty of the drift in it, and what the drift did."""
    drift, n = prepared.drift, len(prepared.angles)
    if not drift.size:
        return outcome, DriftCorrection(np.zeros((0, n)), np.zeros((0, n)), np.zeros((n, n)))
    response, covariance = prepared.drift_response(), drift.covariance
    change = np.concatenate([s.change.ravel() for s in drift.stations])
    parts = response.reshape(n, -1, N_PARTS)
    moved = np.einsum("nkp,kp->kn", parts, change.reshape(-1, N_PARTS))
    blocks = covariance.reshape(parts.shape[1], N_PARTS, parts.shape[1], N_PARTS)
    own = np.einsum("kpkq->kpq", blocks)
    noise = np.sqrt(np.einsum("nkp,kpq,nkq->kn", parts, own, parts))
    added = response @ covariance @ response.T
    outcome = replace(outcome, covariance=outcome.covariance + added)
    if not len(prepared.nests.row):  # else the nests are in the fit, with what the drift took
        outcome = replace(
            outcome,
            chi_square=outcome.chi_square + sum(s.chi_square for s in drift.stations),
            dof=outcome.dof + sum(s.dof for s in drift.stations),
        )
    return outcome, DriftCorrection(moved, noise, added)


def large_drifts(prepared: Prepared, correction: DriftCorrection, std: Floats) -> list[str]:
    """Return in words at which stations the correction is larger than may be taken as linear."""
    if not len(correction.moved):
        return []
    share, noise = correction.shares(std)
    beyond = np.any(share > limits(prepared, noise), axis=1)
    texts, at = [], 0
    for station in prepared.drift.stations:
        parts = slice(at, at + len(station.change))
        at = parts.stop
        if beyond[parts].any():
            texts.append(
                f"tracker station {prepared.problem.station_name(station.station)} moved between "
                f"rounds of nests ({in_words(station)}), which moves deviations by up to "
                f"{share[parts].max():.1f} standard uncertainties; it is taken away as linear in "
                "time, but a knock or a bend would stay: let the tracker settle, or measure the "
                "nests more often (plan.nests_every)"
            )
    return texts


def limits(prepared: Prepared, noise: Floats) -> Floats:
    """Return from where on (K, N) a part is too large: LARGE, or what noise does at most."""
    tests = noise[:, 1:].size
    return np.maximum(LARGE, normal_isf(prepared.problem.significance / 2.0 / tests) * noise)


def unseen_knock(prepared: Prepared, correction: DriftCorrection, std: Floats) -> float:
    """Return the error, in standard uncertainties, of a knock of the tracker found with POWER."""
    _, noise = correction.shares(std)
    found = limits(prepared, noise) + normal_isf(1.0 - POWER) * noise
    return float(KNOCK * found[:, 1:].max())


def in_words(station: StationDrift) -> str:
    """Return the whole change of a station's frame from its first nest to its last."""
    total = station.change.sum(axis=0)
    x, y, azimuth = total[:3] / ARCSEC
    return (
        f"azimuth {azimuth:.1f}, tilts {x:.1f} and {y:.1f} arcsec, range "
        f"{total[6] / MICROMETRE:.1f} um"
    )


def drift_details(
    prepared: PreparedWay, correction: DriftCorrection, std: Floats
) -> dict[str, Any]:
    """Return the drift of each station for the result; nothing where none was estimated."""
    if not prepared.drift.size:
        return {}
    share, _ = correction.shares(std)
    entries, at = [], 0
    for station in prepared.drift.stations:
        spread = np.sqrt(np.diag(station.covariance)).reshape(-1, N_PARTS)
        parts = slice(at, at + len(station.change))
        at = parts.stop
        entries.append(
            {
                "station": prepared.problem.station_name(station.station),
                "knots": station.knots,
                "turn_rad": station.change[:, :3],
                "turn_std_rad": spread[:, :3],
                "shift_m": station.change[:, 3:6],
                "shift_std_m": spread[:, 3:6],
                "range_m": station.change[:, 6],
                "range_std_m": spread[:, 6],
                "probability": station.probability(prepared.problem.significance),
                "moved_standard_uncertainties": share[parts].max(axis=1),
            }
        )
    return {"drift": entries}
