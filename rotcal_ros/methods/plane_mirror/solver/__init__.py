"""Laser tracker and plane mirror: direct, by stitching, by registration, or all in one."""

from rotcal_ros.methods.plane_mirror.settings import WAYS
from rotcal_ros.methods.plane_mirror.solver.problem import (
    PlaneMirrorProblem,
    TrackerNoise,
    problem_from_observations,
)
from rotcal_ros.methods.plane_mirror.solver.registration import check_nests
from rotcal_ros.methods.plane_mirror.solver.solve import METHOD, mirror_trials, solve, solved

__all__ = [
    "METHOD",
    "WAYS",
    "PlaneMirrorProblem",
    "TrackerNoise",
    "check_nests",
    "mirror_trials",
    "problem_from_observations",
    "solve",
    "solved",
]
