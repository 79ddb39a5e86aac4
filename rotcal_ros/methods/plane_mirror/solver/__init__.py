"""Laser tracker and plane mirror: all points in one least squares, and the paper's own ways."""

from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem as PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.problem import TrackerNoise as TrackerNoise
from rotcal_ros.methods.plane_mirror.solver.problem import (
    problem_from_observations as problem_from_observations,
)
from rotcal_ros.methods.plane_mirror.solver.solve import check_nests as check_nests
from rotcal_ros.methods.plane_mirror.solver.solve import curves as curves
from rotcal_ros.methods.plane_mirror.solver.solve import mirror_trials as mirror_trials
from rotcal_ros.methods.plane_mirror.solver.solve import solve as solve
