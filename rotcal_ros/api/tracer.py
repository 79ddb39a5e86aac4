"""Laser tracer on the table, multi-station: ECC from lengths of your own, without a plan.

``solve(Problem(...))`` gives a ``Result``; lengths in m, angles in rad, deviation = actual -
commanded. Raises DataError for data that do not fit together, ObservabilityError where the
geometry cannot determine ECC.

>>> import numpy as np
>>> import rotcal_ros as rc
>>> rng = np.random.default_rng(1)
>>> angles = np.arange(8) * 45 * rc.DEGREE  # commanded
>>> actual = angles + 2 * rc.ARCSEC * np.sin(angles)
>>> stations = 0.15 * np.column_stack([np.cos(actual), np.sin(actual), np.zeros(8)])
>>> targets = rng.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.0], (20, 3))
>>> position, target = np.divmod(np.arange(8 * 20), 20)
>>> length = np.linalg.norm(targets[target] - stations[position], axis=1) - 0.4  # any zero
>>> result = rc.tracer.solve(
...     rc.tracer.Problem(
...         position=position, target=target, length=length, length_std=1e-7,
...         targets=targets, target_std=1e-6, table_angles=angles,
...     )
... )
>>> bool(np.all(np.abs(result.deviations["ECC"] - (actual - angles)) < 0.01 * rc.ARCSEC))
True
"""

from rotcal_ros.methods.tracer.solver import TracerLimits as Limits
from rotcal_ros.methods.tracer.solver import TracerProblem as Problem
from rotcal_ros.methods.tracer.solver import solve

__all__ = ["Limits", "Problem", "solve"]
