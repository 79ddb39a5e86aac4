"""The joint network of stations and targets: one linearisation, and the way to its minimum.

Every length touches one station and one target; one side is eliminated: with a prior the one
with more unknowns, in a free network always the targets. What a free network leaves open is fixed
by constraints; see :mod:`.joint`.

Zeros that several stations share join the stations, which then are always kept: the blocks of the
strips are added up into one matrix of three unknowns per station and one per zero. So they
do where the stations' circle is stated, which ties them together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.solver.adjustment import ranges
from rotcal_ros.methods.tracer.solver.circle_prior import circle_contrasts
from rotcal_ros.methods.tracer.solver.grid import Grid
from rotcal_ros.methods.tracer.solver.layout import UnknownsLayout
from rotcal_ros.methods.tracer.solver.observability import or_prior
from rotcal_ros.methods.tracer.solver.schur import SchurComplement, eliminate, eliminate_from

CONVERGED: Final = 1e-17
"""Squared length in standard deviations of the step that would follow the last."""
CONTRACTING: Final = 1e-4
"""Squared length of a step from which on the ratio of steps tells the next."""
STAGNANT: Final = 1e-6
"""Squared length below which a step that no longer shrinks is rounding."""
FLAT: Final = 1e-4
"""Squared length of a damped step, in standard deviations, that no longer matters."""
SHRINKING: Final = 1e-4
"""Ratio of squared steps above which the normal matrix is made anew."""
MAX_ITERATIONS: Final = 200
LEAST_DAMPING: Final = 1e-9
"""Damping that is none, as a share of the largest weight of a coordinate."""
RIGID_MOTIONS: Final = 6


@dataclass(frozen=True, eq=False)
class Network:
    """One linearisation: ``state`` (p, 4), ``targets`` (n, 3), errors, gradient and normal matrix.

    ``f`` (p, n) is computed - observed, ``rows`` (p, n, 4) the design's station part (its target
    part is minus the first three columns). ``stations_kept``: the targets are eliminated.
    ``layout``: where the strips' coordinates and zeros are among the unknowns. ``prior`` (n, 3):
    weights of the machine's coordinates, 1/m^2; None in a ``free`` network. ``circle`` (c, 3 m):
    slopes of the contrasts of the stations' circle, in its standard deviation; None: none is
    stated. Normal matrices are made when they are asked for.
    """

    state: Floats
    targets: Floats
    f: Floats
    rows: Floats
    chi2: float
    station_gradient: Floats
    target_gradient: Floats
    prior: Floats | None
    stations_kept: bool
    free: bool
    lengths: Floats
    weights: Floats
    layout: UnknownsLayout
    circle: Floats | None = None

    @cached_property
    def blocks(self) -> tuple[Floats, Floats, Floats]:
        """Normal blocks of strips (p, 4, 4), of targets (n, 3, 3), and between them (4 p, 3 n)."""
        p, n = self.f.shape
        unit, weights = self.rows[:, :, :3], self.weights
        weighted = self.rows * weights[:, :, None]
        by_target = np.ascontiguousarray(unit.swapaxes(0, 1))
        stations = self.rows.swapaxes(1, 2) @ weighted
        targets = by_target.swapaxes(1, 2) @ (by_target * weights.T[:, :, None])
        if self.prior is not None:
            targets[:, [0, 1, 2], [0, 1, 2]] += self.prior
        cross = -(weighted.swapaxes(1, 2)[:, :, :, None] * unit[:, None]).reshape(4 * p, 3 * n)
        return stations, targets, cross

    @cached_property
    def reduced(self) -> SchurComplement:
        """The normal matrix with one side eliminated."""
        return self._reduce(self.blocks)

    @property
    def stiffness(self) -> float:
        """The largest weight of a coordinate, 1/m^2."""
        return float(self.blocks[1].max())

    def damped(self, damping: float) -> SchurComplement:
        """Return the normal matrix with ``damping`` (1/m^2) of every coordinate (Levenberg)."""
        if damping == 0.0:
            return self.reduced
        stations, targets, cross = self.blocks
        blocks = (stations + damping * np.eye(4), targets + damping * np.eye(3), cross)
        return self._reduce(blocks)

    def _reduce(self, blocks: tuple[Floats, Floats, Floats]) -> SchurComplement:
        """Eliminate one side of normal ``blocks``; a free network's datum is bound."""
        stations, targets, cross = blocks
        layout, constraints = self.layout, None
        if self.free:
            constraints = _constraints(self.state[layout.first_strip, :3], layout)
        if layout.shared:
            gathered = layout.gather(stations, targets, cross, self.circle)
            return eliminate_from(*gathered, constraints)
        if self.stations_kept:
            return eliminate(stations, targets, cross, constraints)
        return eliminate(targets, stations, np.ascontiguousarray(cross.T))

    def step(self, reduced: SchurComplement) -> tuple[Floats, Floats]:
        """Return the step of strips (p, 4) and targets (n, 3) that ``reduced`` gives."""
        return self.respond(self.station_gradient, self.target_gradient, reduced)

    def bend(self, reduced: SchurComplement, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return what a step (x, y) lacks to keep the errors linear to second order."""
        apart, unit = x[:, None, :3] - y, self.rows[:, :, :3]
        reach = self.f + self.lengths + self.state[:, 3:]
        curve = (apart**2).sum(axis=2) - (unit * apart).sum(axis=2) ** 2
        pull = 0.5 * self.weights * curve / reach
        by_station = (self.rows * pull[:, :, None]).sum(axis=1)
        return self.respond(by_station, -(unit * pull[:, :, None]).sum(axis=0), reduced)

    def respond(
        self, station: Floats, target: Floats, reduced: SchurComplement | None = None
    ) -> tuple[Floats, Floats]:
        """Return the step that takes gradients (p, 4) and (n, 3) to zero."""
        reduced = self.reduced if reduced is None else reduced
        a, b = -self.layout.collect(station), -target.ravel()
        if self.stations_kept:
            x, y = reduced.solve(a, b)
        else:
            y, x = reduced.solve(b, a)
        return x[self.layout.index], y.reshape(self.targets.shape)


def relax(grid: Grid, state: Floats, targets: Floats) -> Network:
    """Return the least-squares network near ``state`` (p, 4) and ``targets`` (n, 3).

    Gauss-Newton while chi-squared falls, with the normal matrix of the start as long as its steps
    shrink fast (chord steps with the gradient of now). A free network may have a long bent valley:
    no length feels the height of a target that is level with the tracer, to first order. Once a
    step has gone wrong the steps follow the bend (Transtrum and Sethna, arXiv:1201.5885), and are
    damped (Levenberg) until chi-squared falls. Where the valley is flat, any place of it will do.
    """
    network, before = linearise(grid, state, targets), np.inf
    damping, curved, chord = 0.0, False, network.reduced
    least = LEAST_DAMPING * network.stiffness
    for _ in range(MAX_ITERATIONS):
        reduced = network.damped(damping) if curved else chord
        by_station, by_target = network.step(reduced)
        squared = -float(
            (network.station_gradient * by_station).sum()
            + (network.target_gradient * by_target).sum()
        )
        if curved:
            more = network.bend(reduced, by_station, by_target)
            by_station, by_target = by_station + more[0], by_target + more[1]
        trial = linearise(grid, network.state + by_station, network.targets + by_target)
        if trial.chi2 > network.chi2 + 1e-9 * max(network.chi2, 1.0):
            if squared < STAGNANT and damping < 2.0 * least:
                return network  # what is left to gain drowns in the rounding of chi-squared
            damping = max(10.0 * damping, least) if curved else 0.0
            curved = True
            continue
        network = trial
        if damping == 0.0:
            contracts = squared < CONTRACTING and before < np.inf
            follows = squared * squared / before if contracts else squared
            if follows < CONVERGED or (squared < STAGNANT and squared > 0.25 * before):
                return network
        elif damping < 2.0 * least and squared < FLAT:
            return network
        damping = 0.1 * damping if damping > 2.0 * least else 0.0
        if squared > SHRINKING * before:
            chord = network.reduced
        before = squared
    raise DataError(
        f"stations and targets do not settle together in {MAX_ITERATIONS} iterations: the lengths "
        f"do not fit the targets; check the order of the targets{or_prior(free=grid.free)}"
    )


def linearise(grid: Grid, state: Floats, targets: Floats) -> Network:
    """Return the network at ``state`` (p, 4), ``targets`` (n, 3): its errors and gradient."""
    p, n = grid.used.shape
    layout, weights = UnknownsLayout.of(grid), grid.weights
    distance, unit = ranges(state[:, :3], targets)
    f = distance - state[:, 3:] - grid.length
    rows = np.concatenate([unit, np.full((p, n, 1), -1.0)], axis=2)
    weighted = rows * weights[:, :, None]
    prior = None
    station_gradient = np.einsum("jia,ji->ja", weighted, f)
    target_gradient = -np.einsum("jia,ji->ia", weighted[:, :, :3], f)
    chi2 = float((weights * f**2).sum())
    if not grid.free:
        correction = (targets - grid.targets) / grid.target_std
        chi2 += float((correction**2).sum())
        target_gradient = target_gradient + correction / grid.target_std
        prior = grid.target_std**-2
    if layout.tension is not None:
        steps, pull = layout.stretch(state[layout.first_of_zero, 3])
        chi2 += float((steps**2).sum())
        station_gradient[layout.first_of_zero, 3] += pull
    circle = None
    if grid.circle_std is not None:
        value, slope = circle_contrasts(state[layout.first_strip, :3])
        off, circle = value / grid.circle_std, slope / grid.circle_std
        chi2 += float((off**2).sum())
        station_gradient[layout.first_strip, :3] += (off @ circle).reshape(-1, 3)
    stations_kept = grid.free or layout.shared or 4 * p <= 3 * n
    return Network(
        state, targets, f, rows, chi2, station_gradient, target_gradient, prior, stations_kept,
        grid.free, grid.length, weights, layout, circle,
    )  # fmt: skip


def rigid(points: Floats) -> Floats:
    """Return what three shifts and three turns about the origin do to ``points``: (3 k, 6)."""
    motions = np.empty((len(points), 3, RIGID_MOTIONS))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = -cross_matrix(points)
    return motions.reshape(-1, RIGID_MOTIONS)


def _constraints(stations: Floats, layout: UnknownsLayout) -> Floats:
    """Return what the ``stations`` (m, 3) must not do in a free network: seven columns.

    Six rigid motions, and growing away from their centroid, which is the station part of the
    seventh up to a shift. None of them changes a zero.
    """
    spread = stations - stations.mean(axis=0)
    return layout.with_zeros(np.column_stack([rigid(spread), spread.ravel()]))
