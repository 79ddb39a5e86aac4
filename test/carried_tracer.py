"""Lengths of a tracer that a table carries, by vectors alone, and their dense least squares."""

import numpy as np
from two_groups import ALTERNATING, ANGLES, turned

from rotcal_ros.methods.tracer.solver import TracerProblem

LENGTH_STD, TARGET_STD, MOTION_STD = 2e-7, 1e-6, 5e-8
TARGETS = np.array(
    [(x, y, z) for x in (-0.3, 0.1, 0.35) for y in (-0.35, 0.02, 0.3) for z in (0.9, 1.3)]
)


def tracer_problem(seed, ecc=ALTERNATING, angles=ANGLES, keep=None, world=0.0, noise=1.0, **more):
    """A problem of a table with ECC (m,) rad at ``angles`` (m,), with a zero for each of them.

    ``keep`` (position, target): which lengths are there. ``world``: the machine is turned by so
    much, rad. ``noise``: that of all in units of what is stated.
    """
    rng, m = np.random.default_rng(seed), len(angles)
    there = TARGETS + noise * TARGET_STD * rng.standard_normal(TARGETS.shape)
    stations = turned(angles + ecc, np.tile([0.2, -0.05, 0.12], (m, 1)))
    stations = stations + np.array([3e-5, -2e-5, 0.0])
    stations[:, :2] += noise * MOTION_STD * rng.standard_normal((m, 2))
    zeros = rng.normal(0.0, 0.1, m)
    length = np.linalg.norm(stations[:, None] - there, axis=2) - zeros[:, None]
    length = length + noise * LENGTH_STD * rng.standard_normal(length.shape)
    position, target = (index.ravel() for index in np.indices(length.shape))
    rows = np.full(len(position), True) if keep is None else keep(position, target)
    return TracerProblem(
        position=position[rows],
        target=target[rows],
        length=length.ravel()[rows],
        length_std=LENGTH_STD,
        targets=turned(np.full(len(TARGETS), world), TARGETS),
        target_std=np.full(TARGETS.shape, TARGET_STD),
        table_angles=angles,
        error_motion_std=MOTION_STD,
        **more,
    )


class DenseTracer:
    """All lengths in one least squares: centre, arm, shifts of each position, zeros, targets."""

    def __init__(self, problem):
        self.problem, self.m = problem, len(problem.table_angles)
        self.sizes = [self.m, 3 * self.m, 3, self.m, problem.targets.size]

    def start(self):
        """Start values: the place of the tracer is known to a tenth of a millimetre."""
        x = np.zeros(sum(self.sizes))
        ecc, _, arm, _, _ = np.split(x, np.cumsum(self.sizes)[:-1])
        arm[:] = [0.2001, -0.0501, 0.1201]
        length = self._distance(x) - self.problem.length
        zeros = np.bincount(self.problem.position, length) / np.bincount(self.problem.position)
        x[4 * self.m + 3 : 5 * self.m + 3] = zeros
        assert not ecc.any()
        return x

    def misfit(self, x):
        """Whitened misfits: lengths, stated targets, shifts in the plane about a free centre."""
        _, shift, _, zero, target = np.split(x, np.cumsum(self.sizes)[:-1])
        lengths = self._distance(x) - zero[self.problem.position] - self.problem.length
        plane = shift.reshape(-1, 3)[:, :2]
        about = (plane - plane.mean(axis=0)).ravel() / MOTION_STD
        return np.concatenate([lengths / LENGTH_STD, target / TARGET_STD, about])

    def _distance(self, x):
        ecc, shift, arm, _, target = np.split(x, np.cumsum(self.sizes)[:-1])
        problem = self.problem
        stations = turned(problem.table_angles + ecc, np.tile(arm, (self.m, 1)))
        stations = stations + shift.reshape(-1, 3)
        there = problem.targets + target.reshape(-1, 3)
        return np.linalg.norm(stations[problem.position] - there[problem.target], axis=1)
