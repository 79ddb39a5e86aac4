"""The rigid network as an adjustment that the tracer's screening and noise estimate work on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.tracer.adjustment import Adjustment
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.joint import target_test
from rotcal_ros.methods.tracer_six.layout import Layout
from rotcal_ros.methods.tracer_six.observability import check_determined
from rotcal_ros.methods.tracer_six.posterior import Posterior, posterior
from rotcal_ros.methods.tracer_six.rig import Rig, State, relax
from rotcal_ros.methods.tracer_six.scatter import Scatter, contrasts, estimate, stated

NONE: Final = stated(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class RigidAdjustment(Adjustment):
    """An adjustment whose stations follow a rigid table, ``posterior`` and ``scatter`` with it."""

    posterior: Posterior = None  # type: ignore[assignment]
    scatter: Scatter = NONE


@dataclass(frozen=True, eq=False)
class RigidAdjuster:
    """Adjusts a grid with the table rigid, from one ``state``; ``stated`` scatter in m and rad.

    A scatter that is not known is estimated anew each time, so that it does not pass for noise.
    """

    layout: Layout
    state: State
    stated: tuple[float | None, float | None]
    significance: float

    def __call__(
        self, grid: Grid, start: Floats, targets: Floats | None = None
    ) -> RigidAdjustment:
        """Return the adjustment of ``grid``; it starts from its own state, whatever is given."""
        rig, scatter = solve_network(grid, self.layout, self.state, self.stated, self.significance)
        return _adjustment(rig, scatter)


def solve_network(
    grid: Grid,
    layout: Layout,
    state: State,
    known: tuple[float | None, float | None],
    significance: float,
) -> tuple[Rig, Scatter]:
    """Return the network at its minimum with the scatter that it tells, or that is ``known``."""
    rig = relax(grid, layout, None, state)
    check_determined(rig)
    arms = rig.state.arms(layout)
    scatter = estimate(contrasts(rig, arms), *known, significance)
    roots = scatter.roots(arms)
    if roots is not None:
        rig = relax(grid, layout, roots, rig.state)
    return rig, scatter


def _adjustment(rig: Rig, scatter: Scatter) -> RigidAdjustment:
    grid, layout, state = rig.grid, rig.layout, rig.state
    after = posterior(rig)
    felt = (rig.slopes.unit @ after.arrived[:, :, None])[:, :, 0]
    corrections, redundancy, coupling = _felt_by_targets(grid, state, after)
    unknowns = layout.size + 6 * len(layout.angles)
    rank = unknowns - rig.reduced.constraints.shape[1]
    extra = 0 if grid.free else state.targets.size
    extra += 0 if layout.tilt_std is None else 2 * len(layout.angles)
    return RigidAdjustment(
        stations=state.stations(layout) + after.arrived,
        distances=state.zeros[layout.zero[:, 0]],
        targets=state.targets,
        residual=-(rig.slopes.error + felt),
        std=grid.length_std,
        redundancy=grid.used - grid.weights * after.leverage,
        chi2=rig.slopes.chi2,
        dof=int(grid.used.sum()) + extra - rank,
        unknowns=unknowns,
        rank=rank,
        target_test=target_test(corrections, redundancy),
        corrections=corrections,
        target_redundancy=np.diagonal(redundancy, axis1=1, axis2=2),
        coupling=coupling,
        posterior=after,
        scatter=scatter,
    )


def _felt_by_targets(grid: Grid, state: State, after: Posterior) -> tuple[Floats, Floats, Floats]:
    """Return corrections (n, 3), redundancy (n, 3, 3), coupling (3, 3) as Adjustment has them."""
    n = len(grid.targets)
    if grid.free:
        return np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((3, 3))
    std = grid.target_std
    whole = -after.targets / (std[:, :, None, None] * std)
    each = np.arange(n)
    whole[each, :, each] += np.eye(3)
    coupling = np.einsum("iajb,iajb->ab", whole, whole)
    return (state.targets - grid.targets) / std, whole[each, :, each], coupling
