"""Laser tracker and plane mirror: all points in one least squares, and the paper's own ways."""

from rotcal_ros.methods.plane_mirror.settings import WAYS
from rotcal_ros.methods.plane_mirror.solver.problem import (
    PlaneMirrorProblem,
    TrackerNoise,
    problem_from_observations,
)
from rotcal_ros.methods.plane_mirror.solver.solve import (
    METHOD,
    check_nests,
    curves,
    mirror_trials,
    solve,
    solved,
)

__all__ = [
    "METHOD",
    "WAYS",
    "PlaneMirrorProblem",
    "TrackerNoise",
    "check_nests",
    "curves",
    "mirror_trials",
    "problem_from_observations",
    "solve",
    "solved",
]
