"""The plan of a quick check by ball plate: the fewest CMM positions that decide it.

All balls of the plate are measured at each position, at every angle of the table. By cyclic
symmetry only their number counts for the mean variance, see
:mod:`rotcal_design.ball_plate.ball_layout`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_design.ball_plate.ball_layout import unit_std
from rotcal_design.settings import CHECK_FILE
from rotcal_ros.foundation.arrays import Floats, Ints, std_of
from rotcal_ros.foundation.curves.interpolation import interpolation_matrix, without_harmonics
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, PlanError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.units import DEGREE, TURN
from rotcal_ros.methods.ball_plate.measuring_order import spread_out
from rotcal_ros.methods.ball_plate.plan import measuring_order
from rotcal_ros.methods.ball_plate.solver.separability import MIN_BALLS
from rotcal_ros.methods.configuration import Configuration, changed
from rotcal_ros.planning.check_rule import CheckRule

LEAST_BALLS: Final = MIN_BALLS + 1
"""Fewest balls at any angle: with one less, nothing would check them."""
_FITTING: Final[Mapping[str, Mapping[str, Any]]] = {
    "plan": {"bidirectional": False},
    "solver": {
        "variant": "least_squares", "drift": "none", "drift_allowance_m": 0.0, "sigma_axes_m": (),
        "own_std": False, "balls": (), "cmm_positions": (), "coarser": 1,
    },
}  # fmt: skip
"""Settings whose other values change what a measurement promises."""


@dataclass(frozen=True, eq=False)
class BallCheckPlan:
    """What to measure: all ``balls`` of the plate at the CMM ``positions``.

    ``configuration`` says so, too. ``std`` (m,), rad: predicted standard uncertainty of each of
    the ``angles`` (m,) less their mean; ``acceptance`` (m,): up to which difference it will be
    still valid. ``assurance``: with what probability, at least, a table is found still valid that
    has only aged as stated. ``seconds`` the measurement takes.
    """

    configuration: Configuration
    rule: CheckRule
    angles: Floats
    positions: tuple[int, ...]
    balls: int
    std: Floats
    acceptance: Floats
    assurance: float
    seconds: float

    @property
    def at_each_angle(self) -> Ints:
        """How many balls are measured at each angle (m,)."""
        plate = self.configuration.plan.plate
        return _centres(plate.grid, plate.ball_steps, self.positions)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        return {
            "centres": int(self.at_each_angle.sum()),
            "offered": len(self.angles) * self.balls,
            "duration_s": self.seconds,
            "assurance": self.assurance,
            "angles_rad": self.angles.tolist(),
            "predicted_std": self.std.tolist(),
            "acceptance": self.acceptance.tolist(),
            "cmm_positions": list(self.positions),
        }

    def write(self, folder: Path) -> Path:
        """Write the configuration into ``folder``; return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / CHECK_FILE, self.configuration.text)
        return folder / CHECK_FILE


def plan_ball_check(
    configuration: Configuration, earlier: MeasuredCurve, rule: CheckRule
) -> BallCheckPlan:
    """Choose the fewest CMM positions at which the plate of ``configuration`` checks ``earlier``.

    ``earlier`` is a curve of ECC, rad, all the way round. ``solver.sigma_centre_m`` states the
    noise. Raises ConfigurationError for settings that promise something else, PlanError where all
    positions do not suffice.
    """
    _require_fitting(configuration)
    plate = configuration.plan.plate
    if not earlier.period:
        raise PlanError("the earlier curve is that of an arc, and a plate measures whole turns")
    angles = (
        configuration.plan.table_start_deg * DEGREE + TURN * np.arange(plate.grid) / plate.grid
    )
    at = interpolation_matrix(earlier.angles, angles, TURN)
    free = without_harmonics(angles, 0)
    expected = std_of(rule.expected(at @ earlier.covariance @ at.T, free))
    spread = spread_out(plate.grid)

    def std(count: int) -> Floats:
        unit = unit_std(plate.grid, list(plate.ball_steps), spread[:count], plate.circle_radius_m)
        return np.asarray(configuration.solver.sigma_centre_m * unit["ECC"])

    def enough(count: int) -> bool:
        if _centres(plate.grid, plate.ball_steps, spread[:count]).min() < LEAST_BALLS:
            return False
        try:
            return rule.assurance(std(count), expected) >= 1.0 - rule.false_alarm
        except ObservabilityError:
            return False

    if not enough(plate.grid):
        smallest = rule.smallest_limit(std(plate.grid), expected) / rule.limit
        raise PlanError(
            f"even {len(plate.ball_steps)} balls at all {plate.grid} CMM positions would not find "
            "a table that has only aged as stated within the limit often enough: ask for at least "
            f"{smallest:.2f} times this limit, or for other risks, or calibrate anew"
        )
    count = bisect_left(range(plate.grid), True, lo=LEAST_BALLS, key=enough)
    positions, found = tuple(np.sort(spread[:count]).tolist()), std(count)
    settings = replace(configuration.plan, cmm_positions=positions)
    return BallCheckPlan(
        configuration=changed(configuration, [f"plan.cmm_positions={list(positions)}"]),
        rule=rule,
        angles=angles,
        positions=positions,
        balls=len(plate.ball_steps),
        std=found,
        acceptance=rule.acceptance(found),
        assurance=rule.assurance(found, expected),
        seconds=measuring_order(settings).duration,
    )


def _centres(grid: int, balls: tuple[int, ...], positions: Ints | tuple[int, ...]) -> Ints:
    """Return at how many CMM positions each table position (N,) has a ball."""
    seen = np.subtract.outer(np.asarray(positions), np.asarray(balls)) % grid
    return np.bincount(seen.ravel(), minlength=grid)


def _require_fitting(configuration: Configuration) -> None:
    """Raise ConfigurationError unless what is planned is what will be solved."""
    source = configuration.source
    for group, settings in _FITTING.items():
        for name, wanted in settings.items():
            found = getattr(configuration.group(group), name)
            if found != wanted:
                raise ConfigurationError(
                    f"{source}: {group}.{name} is {found}: a quick check is planned for {wanted}"
                )
    if not configuration.solver.sigma_centre_m:
        raise ConfigurationError(
            f"{source}: solver.sigma_centre_m is absent, and the few balls of a quick check would "
            "have to determine it: state what the full calibration has found"
        )
