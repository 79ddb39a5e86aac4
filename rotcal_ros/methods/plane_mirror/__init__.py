"""Laser tracker and plane mirror: direct, by stitching, by registration, or all in one."""

from rotcal_ros.methods.plane_mirror.problem import (
    WAYS,
    PlaneMirrorProblem,
    TrackerNoise,
    problem_from_observations,
)
from rotcal_ros.methods.plane_mirror.solve import METHOD, solve

__all__ = [
    "METHOD",
    "WAYS",
    "PlaneMirrorProblem",
    "TrackerNoise",
    "problem_from_observations",
    "solve",
]
