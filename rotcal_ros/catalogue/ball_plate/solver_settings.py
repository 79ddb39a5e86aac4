"""The settings of the ball plate method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.settings import setting


@dataclass(frozen=True)
class BallPlateSolverSettings:
    """How the ball plate method is solved, and which part of the data is evaluated."""

    sigma_centre_m: float = setting(
        0.0,
        doc="m, known standard deviation of a ball centre; 0: from the residuals",
        minimum=0.0,
        maximum=1e-2,
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
