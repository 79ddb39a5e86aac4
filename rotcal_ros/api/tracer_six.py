"""Laser tracer at three or more places of the table: six deviations from lengths of your own.

``solve(Problem(...))`` gives a ``Result``; lengths in m, angles in rad, deviation = actual -
commanded. Raises DataError for data that do not fit together, ObservabilityError where the
geometry cannot tell.

>>> import numpy as np
>>> import rotcal_ros as rc
>>> rng = np.random.default_rng(1)
>>> angles = np.arange(6) * 60 * rc.DEGREE  # commanded
>>> lift = 1e-6 * np.cos(2 * angles)  # EZC
>>> targets = rng.uniform([-0.6, -0.5, 0.3], [0.6, 0.5, 1.0], (16, 3))
>>> at = 120 * rc.DEGREE * np.arange(3)
>>> places = np.column_stack([0.15 * np.cos(at), 0.15 * np.sin(at), np.full(3, 0.1)])
>>> place, position, target = (axis.ravel() for axis in np.indices((3, 6, 16)))
>>> turned = (at[place] + angles[position])[:, None]
>>> station = np.hstack([0.15 * np.cos(turned), 0.15 * np.sin(turned), 0.1 + 0 * turned])
>>> station[:, 2] += lift[position]
>>> length = np.linalg.norm(targets[target] - station, axis=1) - 0.4  # any zero
>>> result = rc.tracer_six.solve(
...     rc.tracer_six.Problem(
...         place=place, position=position, target=target, length=length, length_std=1e-7,
...         targets=targets, target_std=1e-6, table_angles=angles, places=places,
...     )
... )
>>> bool(np.all(np.abs(result.deviations["EZC"] - lift) < 1e-8))
True
"""

from rotcal_ros.methods.tracer_six import SixProblem as Problem
from rotcal_ros.methods.tracer_six import solve

__all__ = ["Problem", "solve"]
