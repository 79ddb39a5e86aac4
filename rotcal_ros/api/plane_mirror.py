"""Laser tracker with a plane mirror on the table: ECC from points of your own.

``solve(Problem(...))`` gives a ``Result``. Points (n, 3) in m in the frame of each tracker
station; ``kind`` is ``rc.PointKind`` DIRECT, MIRRORED or NEST; deviation = actual - commanded in
rad. Raises DataError for points that do not fit together, ObservabilityError where the stations
cannot be joined.

>>> import numpy as np
>>> import rotcal_ros as rc
>>> angles = np.array([0.0, 10.0, 20.0]) * rc.DEGREE  # commanded, one station
>>> actual = angles + np.array([0.0, 3.0, 1.0]) * rc.ARCSEC
>>> normals = np.column_stack([np.cos(actual), np.sin(actual), np.full(3, 0.02)])
>>> normals /= np.linalg.norm(normals, axis=1)[:, None]
>>> axis = np.array([-2.0, 0.1, -0.3])  # the table, seen from the tracker
>>> direct = np.array([[-0.6, 0.7, 0.2], [-0.7, -0.6, -0.4]])  # two reflectors
>>> away = np.einsum("ik,jik->ij", normals, direct[:, None] - axis) - 0.05
>>> mirrored = direct - 2 * away[..., None] * normals[:, None]
>>> position, nest = np.divmod(np.arange(6), 2)
>>> shaken = direct[nest] + 1e-9 * np.arange(6)[:, None]  # no two points are alike
>>> problem = rc.plane_mirror.Problem(
...     angles=angles, position=np.tile(position, 2), station=np.zeros(12, int),
...     kind=np.repeat([rc.PointKind.DIRECT, rc.PointKind.MIRRORED], 6), nest=np.tile(nest, 2),
...     xyz=np.vstack([shaken, mirrored.reshape(-1, 3)]), way="stitching",
... )
>>> error = rc.plane_mirror.solve(problem).deviations["ECC"] - (actual - angles)
>>> bool(np.all(np.abs(error) < 0.01 * rc.ARCSEC))
True
"""

from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem as Problem
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, solve

__all__ = ["Problem", "TrackerNoise", "solve"]
