"""ok, suspect or failed: the rules, and the sentences that say why.

suspect
    the chi-squared test of the lengths fails (the covariance is then enlarged by sigma0^2), more
    than ``max_rejected_share`` of the lengths were rejected, a closure is larger than its
    uncertainty allows, the stations leave the circle by more than the stated error motion, or a
    position of the plan is missing.
failed
    sigma0 beyond 10 (the model does not describe the data) or more than a fifth of the lengths
    rejected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.distributions import normal_isf
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.uncertainty import GlobalTest
from rotcal_ros.results import Verdict

FAILED_SIGMA0: Final = 10.0
FAILED_SHARE: Final = 0.2
TURN: Final = 2.0 * np.pi
SAME_ANGLE: Final = 1e-9
"""Turns that the sum of commanded steps may be off by rounding; 1.3 milliarcsec."""


@dataclass(frozen=True, slots=True)
class Closure:
    """Two positions at the same table angle, whole turns apart: what should agree, and how well.

    ``error`` is the deviation at position ``last`` minus that at ``first``, with its standard
    deviation ``std``; radians.
    """

    first: int
    last: int
    error: float
    std: float


def closures(
    angles: Floats, cumulative: Floats, covariance: Floats, position_ids: Ints
) -> tuple[Closure, ...]:
    """Return the closures of ``angles`` (m,): later positions against the first at their angle."""
    found = []
    for last in range(1, len(angles)):
        apart = (angles[last] - angles[:last]) / TURN
        same = np.flatnonzero(np.abs(apart - np.round(apart)) < SAME_ANGLE)
        if len(same):
            first = int(same[0])
            pair = np.ix_([first, last], [first, last])
            variance = float(np.array([-1.0, 1.0]) @ covariance[pair] @ np.array([-1.0, 1.0]))
            found.append(
                Closure(
                    first=int(position_ids[first]),
                    last=int(position_ids[last]),
                    error=float(cumulative[last] - cumulative[first]),
                    std=float(np.sqrt(max(variance, 0.0))),
                )
            )
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the verdict rests on; ``missing`` are positions without a result."""

    lengths: GlobalTest
    circle: GlobalTest
    radial_rms: float
    closures: tuple[Closure, ...]
    n_lengths: int
    n_rejected: int
    missing: tuple[int, ...]
    unchecked: int
    mirror_ambiguous: bool


def judge(evidence: Evidence, settings: TracerLimits) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its warnings by the rules in this module's docstring."""
    doubts = [
        *_doubt_lengths(evidence, settings),
        *_doubt_stations(evidence, settings),
    ]
    share = evidence.n_rejected / evidence.n_lengths
    verdict: Verdict = "suspect" if doubts else "ok"
    if evidence.lengths.sigma0 > FAILED_SIGMA0 or share > FAILED_SHARE:
        verdict = "failed"
    return verdict, (*doubts, *_remarks(evidence, settings))


def _doubt_lengths(evidence: Evidence, settings: TracerLimits) -> list[str]:
    doubts = []
    if evidence.lengths.probability < settings.test_significance:
        doubts.append(
            f"the residuals of the lengths are {evidence.lengths.sigma0:.2f} times what their "
            "stated standard deviations allow (chi-squared test): the uncertainty is enlarged by "
            "that factor; look for drift, or state larger standard deviations"
        )
    share = evidence.n_rejected / evidence.n_lengths
    if share > settings.max_rejected_share:
        doubts.append(
            f"{evidence.n_rejected} of {evidence.n_lengths} lengths ({100 * share:.1f} %) were "
            f"rejected, more than {100 * settings.max_rejected_share:g} % is suspicious: look for "
            "a target with wrong coordinates, or an unstable beam"
        )
    return doubts


def _doubt_stations(evidence: Evidence, settings: TracerLimits) -> list[str]:
    doubts: list[str] = []
    limit = normal_isf(0.5 * settings.test_significance)
    doubts += [
        f"stations {c.first} and {c.last} stand at the same table angle but differ by "
        f"{c.error:.3g} rad, expected 0 with a standard deviation of {c.std:.3g} rad: something "
        "moved or drifted during the run"
        for c in evidence.closures
        if abs(c.error) > limit * c.std
    ]
    if evidence.circle.probability < settings.test_significance:
        doubts.append(
            f"the stations leave their circle by {evidence.radial_rms:.3g} m (rms), "
            f"{evidence.circle.sigma0:.1f} times what is expected: the table's radial error "
            "motion is larger than error_motion_std says, and so is the uncertainty of the angles"
        )
    if evidence.missing:
        names = ", ".join(str(j) for j in evidence.missing)
        doubts.append(f"no deviation for station(s) {names}: too few usable lengths")
    return doubts


def _remarks(evidence: Evidence, settings: TracerLimits) -> list[str]:
    remarks = []
    if 1.0 - evidence.lengths.probability < settings.test_significance:
        remarks.append(
            f"the residuals of the lengths are only {evidence.lengths.sigma0:.2f} times their "
            "stated standard deviations; the uncertainty is not reduced for that"
        )
    if evidence.unchecked:
        remarks.append(
            f"{evidence.unchecked} lengths are checked by no other: an error in them stays unseen"
        )
    if evidence.mirror_ambiguous:
        remarks.append(
            "all targets lie in one plane, so the tracer could stand on either side of it: the "
            "lower side was taken; give start_stations to choose the other"
        )
    return remarks
