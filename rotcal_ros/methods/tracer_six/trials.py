"""Monte Carlo trials of the six-deviations method: each is solved to its minimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.tracer_six.curves import table_curves
from rotcal_ros.methods.tracer_six.problem import SixProblem
from rotcal_ros.methods.tracer_six.rig import relax
from rotcal_ros.methods.tracer_six.solution import SixSolution, adjust


@dataclass(frozen=True, eq=False)
class SixTrials:
    """Draws measurements like the given one and solves them; made by :func:`six_trials`."""

    solution: SixSolution

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the curves (count, 6 m) of simulated measurements, in the order of COMPONENTS.

        The measured values with fresh noise of lengths and targets, and a fresh scatter of the
        table, whose size is drawn from what is known of it.
        """
        return np.stack([self._trial(rng) for _ in range(count)])

    def _trial(self, rng: np.random.Generator) -> Floats:
        solution = self.solution
        rig, layout, grid = solution.rig, solution.layout, solution.grid
        length = grid.length + solution.scale * grid.length_std * rng.standard_normal(
            grid.length.shape
        )
        arms = rig.state.arms(layout)
        known = solution.scatter
        shift, turn = np.sqrt(known.variances[rng.choice(len(known.weights), p=known.weights)])
        moved = shift * rng.standard_normal(arms.shape)
        moved += np.cross(turn * rng.standard_normal(arms.shape), arms)
        length += (rig.slopes.unit @ moved[:, :, None])[:, :, 0]
        targets = grid.targets
        if not grid.free:
            errors = rng.standard_normal(targets.shape)
            targets = targets + solution.scale * grid.target_std * errors
        drawn = replace(grid, length=length, targets=targets)
        state = relax(drawn, layout, rig.scatter, rig.state).state
        curves = table_curves(state.rotation, state.translation, layout.angles)
        return np.concatenate([curves.translation.T.ravel(), curves.rotation.T.ravel()])


def six_trials(problem: SixProblem) -> SixTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses.

    Rejected lengths stay rejected.
    """
    return SixTrials(adjust(problem))
