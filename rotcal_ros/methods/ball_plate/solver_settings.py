"""The settings of the ball plate method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting

DRIFTS: Final = ("none", "linear", "quadratic")
"""Drifts that can be estimated along; their places are the degrees in time."""


@dataclass(frozen=True)
class BallPlateSolverSettings:
    """How the ball plate method is solved, and which part of the data is evaluated."""

    sigma_centre_m: float = setting(
        0.0,
        doc="m, known standard deviation of a ball centre; 0: from the residuals",
        minimum=0.0,
        maximum=1e-2,
    )
    drift: str = setting(
        "none",
        doc="drift of the CMM's origin over the run that is estimated, for each axis",
        choices=DRIFTS,
    )
    drift_allowance_m: float = setting(
        0.0,
        doc="m, drift of the CMM's origin over the run, along each axis, that the uncertainty "
        "covers where it is not estimated; 0: none stated",
        minimum=0.0,
        maximum=1e-3,
    )
    group_allowance_m: float = setting(
        0.0,
        doc="m, on the circle of the balls: largest difference between the zeros of groups of "
        "table positions (plan.plate.separate_groups); 0: none stated, the difference is unknown",
        minimum=0.0,
        maximum=1e-3,
    )
    sigma_axes_m: tuple[float, ...] = setting(
        (),
        doc="m, known standard deviations of a ball centre in x, y, z; empty: the same in all",
        minimum=0.0,
        maximum=1e-2,
    )
    own_std: bool = setting(
        False, doc="weight every centre by the standard deviation that the machine states for it"
    )
    balls: tuple[int, ...] = setting(
        (), doc="ball steps to evaluate, on the grid of the plate; empty: all", minimum=0
    )
    cmm_positions: tuple[int, ...] = setting(
        (), doc="CMM positions to evaluate, on the grid of the plate; empty: all", minimum=0
    )
    coarser: int = setting(
        1, doc="evaluate only every n-th step of the grid", minimum=1, maximum=1000
    )

    def __post_init__(self) -> None:
        """Raise ConfigurationError unless one standard deviation or three are stated."""
        if not self.sigma_axes_m:
            return
        if len(self.sigma_axes_m) != 3 or min(self.sigma_axes_m) <= 0.0:
            raise ConfigurationError(
                f"sigma_axes_m: expected three positive lengths (x, y, z), found "
                f"{list(self.sigma_axes_m)}"
            )
        if self.sigma_centre_m:
            raise ConfigurationError("give sigma_centre_m or sigma_axes_m, not both")
