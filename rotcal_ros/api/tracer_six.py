"""Laser tracer at three places on the table: all six deviations from lengths of your own.

``solve(Problem(...))`` gives a ``Result``; lengths in m, angles in rad, deviation = actual -
commanded. Raises DataError for data that do not fit together, ObservabilityError where places or
lengths cannot determine all six.

>>> import numpy as np
>>> import rotcal_ros as rc
>>> rng = np.random.default_rng(1)
>>> angles = np.arange(6) * 60 * rc.DEGREE  # commanded
>>> lift = 2 * rc.MICROMETRE * np.cos(2 * angles)  # EZC, injected
>>> corners = np.arange(3) * 120 * rc.DEGREE
>>> places = 0.15 * np.column_stack([np.cos(corners), np.sin(corners), np.zeros(3)])
>>> targets = rng.uniform([-0.6, -0.5, 0.3], [0.6, 0.5, 1.0], (20, 3))
>>> place, position, target = (x.ravel() for x in np.mgrid[:3, :6, :20])  # three runs
>>> turn = angles[position] + corners[place]
>>> tracer = np.column_stack([0.15 * np.cos(turn), 0.15 * np.sin(turn), lift[position]])
>>> length = np.linalg.norm(targets[target] - tracer, axis=1) - 0.4  # any zero
>>> result = rc.tracer_six.solve(
...     rc.tracer_six.Problem(
...         position=position, place=place, target=target, length=length, length_std=2e-7,
...         targets=targets, target_std=1e-6, table_angles=angles, places=places,
...     )
... )
>>> bool(np.all(np.abs(result.deviations["EZC"] - lift) < 0.001 * rc.MICROMETRE))
True
"""

from rotcal_ros.methods.tracer_six.solver import SixProblem as Problem
from rotcal_ros.methods.tracer_six.solver import solve

__all__ = ["Problem", "solve"]
