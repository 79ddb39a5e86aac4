"""From the covariance of the stations to that of the angles, with its budget.

Standard uncertainties are for a normal distribution: the 95 % interval is +-1.96 times the
standard deviation. The stated standard deviations are taken as known (GUM type B) while the
residuals do not contradict them; then the estimates of :mod:`.noise` take their place. There is
no t factor for those: lengths are many. The few residuals of the circle get theirs in
:mod:`.error_motion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment, StationCovariance
from rotcal_ros.methods.tracer.solver.angles import TableMotion, bearing_slopes
from rotcal_ros.methods.tracer.solver.error_motion import CircleTest, error_motion_spread


@dataclass(frozen=True, eq=False)
class AngleUncertainty:
    """Covariance of the cumulative deviations (m, m) in rad^2, and standard deviations from it.

    ``adjacent_std`` (m - 1,) belongs to the adjacent deviations. ``budget`` maps each source to
    its share (m,) of the cumulative standard deviation; the shares add in squares.
    """

    covariance: Floats
    std: Floats
    adjacent_std: Floats
    budget: Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class GlobalTest:
    """A chi-squared test: ``sigma0`` = sqrt(chi2 / dof), and the chance to exceed it."""

    sigma0: float
    probability: float


@dataclass(frozen=True, slots=True)
class CircleStatement:
    """What was stated of the stations' circle, and what became of it.

    ``stated``, ``used``: standard deviations, m. ``redundancy``: share of the statement that the
    lengths check, ``dof`` of its test.
    """

    stated: float
    used: float
    redundancy: float
    dof: int
    sigma0: float
    probability: float


UNTESTED: Final = GlobalTest(1.0, 1.0)
"""Of nothing: no degree of freedom is left."""


def angle_uncertainty(
    motion: TableMotion,
    fit: Adjustment,
    covariance: StationCovariance,
    error_motion_std: float,
    scale: float,
    slips: Floats | None = None,
    gathered: Floats | None = None,
) -> AngleUncertainty:
    """Propagate the stations' covariance times ``scale``^2 and the error motion to the angles.

    ``slips`` (3 m, 3 m): what unseen slips add to that of the stations, m^2. ``gathered`` (m, m):
    what disturbances that gather in one place add to that of the cumulative angles, rad^2.
    """
    bearing, own = bearing_slopes(fit.stations, motion), covariance.enlarged(scale)
    sources = {
        "lengths": own.lengths,
        "targets": own.targets,
        "error_motion": error_motion_spread(motion, error_motion_std),
    }
    if own.circle is not None:
        sources["circle"] = own.circle
    if slips is not None:
        sources["slips"] = LowRank.whole(slips, 3)
    spread = bearing.spread(sum(list(sources.values())[1:], own.lengths))
    every = np.arange(len(fit.stations))
    first = np.zeros_like(every)
    budget = {
        name: _root(bearing.spread(part).between(first, every)) for name, part in sources.items()
    }
    joint = spread.from_first()
    of_steps = _root(spread.between(every[:-1], every[1:]))
    if gathered is not None:
        joint += 0.5 * (gathered + gathered.T)
        steps = LowRank.whole(gathered).between(every[:-1], every[1:])
        of_steps = np.hypot(of_steps, _root(steps))
        budget["gathered"] = _root(gathered.diagonal())
    return AngleUncertainty(
        covariance=joint,
        std=np.sqrt(joint.diagonal()),
        adjacent_std=of_steps,
        budget=budget,
    )


def length_test(fit: Adjustment, dof_effective: float) -> GlobalTest:
    """Compare the residuals of the lengths with their stated standard deviations."""
    if fit.dof <= 0:
        return UNTESTED
    probability = chi2_sf(fit.chi2 * dof_effective / fit.dof, dof_effective)
    return GlobalTest(float(np.sqrt(fit.chi2 / fit.dof)), probability)


def circle_test(circle: CircleTest) -> GlobalTest:
    """Compare the stations' distances from the circle with their covariance.

    What the circle has absorbed (centre and radius) is projected out; m - 3 degrees of freedom
    remain. The table's error motion shows here by its radial part; its tangential part is what
    the angle cannot be told from. A stated circle has twice as many, the axial ones, or fewer
    where the lengths do not tell them.
    """
    dof = circle.residuals.dof
    if dof == 0:
        return UNTESTED
    chi2 = float(circle.residuals.squares(circle.residuals.seen[None])[0])
    return GlobalTest(float(np.sqrt(chi2 / dof)), chi2_sf(chi2, dof))


def _root(variance: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)
