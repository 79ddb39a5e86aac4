"""The tracer's network by Ceres, where it is installed: its trust region with a Schur complement.

One residual block for each target, with its lengths from all stations and its own coordinates, so
that Python is called once a target and not once a length.
"""

import numpy as np
import pyceres


class TargetCost(pyceres.CostFunction):
    """Lengths from m stations to one target, and the target as the machine states it."""

    def __init__(self, target, length, length_std, target_std):
        super().__init__()
        self.target, self.length = target, length
        self.length_std, self.target_std = length_std, target_std
        self.set_num_residuals(len(length) + 3)
        self.set_parameter_block_sizes([4] * len(length) + [3])

    def Evaluate(self, parameters, residuals, jacobians):  # noqa: N802 - the name is Ceres'
        """Fill residuals (m + 3,) and, block by block, their derivatives."""
        m = len(self.length)
        stations, target = np.array(parameters[:m]), parameters[m]
        difference = stations[:, :3] - target
        away = np.sqrt((difference**2).sum(axis=1))
        residuals[:m] = (away - stations[:, 3] - self.length) / self.length_std
        residuals[m:] = (target - self.target) / self.target_std
        if jacobians is not None:
            unit = difference / away[:, None] / self.length_std
            for j in range(m):
                slope = np.zeros((m + 3, 4))
                slope[j, :3], slope[j, 3] = unit[j], -1.0 / self.length_std
                jacobians[j][:] = slope.ravel()
            known = np.eye(3) / self.target_std
            jacobians[m][:] = np.concatenate([-unit, known]).ravel()
        return True


def solve_network(targets, length, length_std, target_std, flat):
    """Return (4 m + 3 n,): stations with their distances, then targets; ``flat`` is the start."""
    m, n = length.shape
    stations = [np.array(block) for block in flat[: 4 * m].reshape(m, 4)]
    found = [np.array(block) for block in flat[4 * m :].reshape(n, 3)]
    problem = pyceres.Problem()
    costs = [TargetCost(targets[i], length[:, i], length_std, target_std) for i in range(n)]
    for cost, target in zip(costs, found, strict=True):
        problem.add_residual_block(cost, None, [*stations, target])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.function_tolerance = options.gradient_tolerance = 1e-16
    options.parameter_tolerance = 1e-16
    options.num_threads = 1
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, problem, pyceres.SolverSummary())
    return np.concatenate([*stations, *found])
