"""Monte Carlo trials of six deviations: every trial is solved to the end.

Gauss-Newton with the exact slopes of each trial and the normal matrix of the measurement, as in
:mod:`rotcal_ros.methods.tracer.solver.trials`; but one by one, for the table turns in space.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.trials import MOST_STEPS, SETTLED
from rotcal_ros.methods.tracer_six.solver.curves import table_curves
from rotcal_ros.methods.tracer_six.solver.layout import StationLayout
from rotcal_ros.methods.tracer_six.solver.network import LengthNetwork, NetworkState, relax, slopes
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.scatter import roots_of
from rotcal_ros.methods.tracer_six.solver.solution import SixSolution, adjust


@dataclass(frozen=True, eq=False)
class SixTrials:
    """Draws measurements like the given one and solves them; made by :func:`six_trials`.

    The measured lengths, targets and stated tilts get fresh noise, every arrival a fresh scatter,
    and a fringe slips as often as it would stay unseen. How large the scatter is follows that of
    the solution: as stated, or as likely as it was found.
    """

    solution: SixSolution

    @property
    def network(self) -> LengthNetwork:
        """The network of the measurement."""
        return self.solution.network

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles, (count, 6 m)."""
        return np.array([self._solved(*self._drawn(rng)) for _ in range(count)])

    def _drawn(self, rng: np.random.Generator) -> tuple[Grid, StationLayout]:
        grid, layout, scale = self.network.grid, self.network.layout, self.solution.scale
        known = self.solution.scatter
        arms = self.network.state.arms(layout)
        shift, turn = known.variances[rng.choice(len(known.weights), p=known.weights)]
        spread = roots_of(shift, turn, arms) @ rng.standard_normal((len(arms), 3, 1))
        noise = scale * grid.length_std * rng.standard_normal(grid.length.shape)
        length = grid.length + noise + (self.network.slopes.unit @ spread)[:, :, 0]
        if self.solution.slips is not None:
            length += self.solution.slips.draw(grid, rng, 1)[0]
        if layout.tilt_std is not None:
            tilts = scale * layout.tilt_std * rng.standard_normal((len(layout.angles), 2))
            layout = replace(layout, tilts=tilts)
        if grid.free:
            return replace(grid, length=length), layout
        missed = scale * grid.target_std * rng.standard_normal(grid.targets.shape)
        return replace(grid, length=length, targets=grid.targets + missed), layout

    def _solved(self, grid: Grid, layout: StationLayout) -> Floats:
        state = self._settled(grid, layout)
        curves = table_curves(state.rotation, state.translation, self.network.layout.angles)
        return np.concatenate([curves.translation.T.ravel(), curves.rotation.T.ravel()])

    def _settled(self, grid: Grid, layout: StationLayout) -> NetworkState:
        state = self.network.state
        for _ in range(MOST_STEPS):
            here = slopes(grid, layout, self.network.scatter, state)
            kept, poses = self._step(-here.kept, -here.poses)
            state = state.moved(kept, poses.reshape(-1, 6))
            if abs(float(here.kept @ kept + here.poses.ravel() @ poses)) < SETTLED:
                return state
        return relax(grid, layout, self.network.scatter, state).state

    def _step(self, kept: Floats, poses: Floats) -> tuple[Floats, Floats]:
        """Return the steps (K,) and (6 m,) for right-hand sides (K,) and (m, 6)."""
        reduced = self.network.reduced
        x = reduced.covariance() @ (kept - reduced.transfer @ poses.ravel())
        own = (reduced.inverse @ poses[:, :, None]).ravel()
        return x, own - reduced.transfer.T @ x


def six_trials(problem: SixProblem) -> SixTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses.

    Rejected lengths stay rejected.
    """
    return SixTrials(adjust(problem))
