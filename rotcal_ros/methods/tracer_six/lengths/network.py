"""The network of stations, zeros and targets that lengths tie together: its linear algebra.

Every length touches one station and one target, so that the normal equations have two block
diagonals:

    [ A   C ] [x]   [a]      A: p blocks (s, s), stations or targets - the kept side
    [ C'  B ] [y] = [b]      B: q blocks (t, t), the other - the eliminated side

Eliminating B leaves p s unknowns (Schur complement), from whose inverse all covariances follow.
With a prior the side with more unknowns is eliminated, in a free network always the targets; what
a free network leaves open is fixed by constraints, see :mod:`.joint`.

With a zero per station the unknowns of the stations are (X, Y, Z, d), station by station. Zeros
that several stations share join the stations, which then are always kept: the blocks of the strips
are added up into one matrix of the coordinates of all stations, then all zeros. The same holds
where the stations' circle is stated, which ties them together.

Where many stations are tied by nothing but targets, whatever lengths of one station have to do
with those of others goes by way of the targets: :func:`view_of` then never makes the whole
covariance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.low_rank import LowRank, Slopes
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer_six.lengths.adjustment import Adjustment, ranges
from rotcal_ros.methods.tracer.solver.circle import circle_contrasts
from rotcal_ros.methods.tracer.solver.observability import or_prior
from rotcal_ros.methods.tracer.solver.problem import Grid

_UNDETERMINED: Final = (
    "the lengths do not determine stations and targets together: the normal matrix is singular; "
    "measure more targets from more stations"
)
CONVERGED: Final = 1e-17
"""Squared length in standard deviations of the step that would follow the last."""
CONTRACTING: Final = 1e-4
"""Squared length of a step from which on the ratio of steps predicts the next."""
STAGNANT: Final = 1e-6
"""Squared length below which a step that no longer shrinks is rounding."""
FLAT: Final = 1e-4
"""Squared length of a damped step, in standard deviations, that no longer matters."""
SHRINKING: Final = 1e-4
"""Ratio of squared steps above which the normal matrix is made anew."""
MAX_ITERATIONS: Final = 200
"""Steps on the way to the minimum: many, for the bent valleys of free networks."""
LEAST_DAMPING: Final = 1e-9
"""Damping that is none, as a share of the largest weight of a coordinate."""
RIGID_MOTIONS: Final = 6
"""Three shifts and three turns."""
KNOWN: Final = 1e-9
"""Standard deviation (m) of a coordinate that is called known, where others have errors."""


@dataclass(frozen=True, eq=False)
class SchurComplement:
    """The Schur complement of one normal matrix.

    ``matrix`` (p s, p s) = A - C B^-1 C'; ``inverse`` (q, t, t) = B^-1;
    ``transfer`` (p s, q t) = C B^-1; ``scale`` (p s,) brings the diagonal of ``matrix`` to one;
    ``constraints`` (p s, c): orthonormal columns that the scaled x has to be orthogonal to.
    """

    matrix: Floats
    inverse: Floats
    transfer: Floats
    scale: Floats
    constraints: Floats

    def regular(self) -> Floats:
        """Return the scaled matrix plus the squared constraints: positive definite."""
        # the squared constraints lift exactly the directions that the matrix leaves at zero
        scaled = self.matrix * self.scale * self.scale[:, None]
        return np.asarray(scaled + self.constraints @ self.constraints.T, dtype=np.float64)

    def solve(self, kept: Floats, other: Floats) -> tuple[Floats, Floats]:
        """Return x (p s,) and y (q t,) for right-hand sides of those shapes.

        Raises ObservabilityError when the matrix is singular in spite of its constraints.
        """
        factor = self._factor
        reduced = self.scale * (kept - self.transfer @ other)
        both = cho_solve(factor, np.column_stack([reduced, self.constraints]), check_finite=False)
        x = self.scale * (both[:, 0] - self._violation(both[:, 1:], both[:, :1])[:, 0])
        q, t, _ = self.inverse.shape
        y = (self.inverse @ other.reshape(q, t, 1)).ravel() - self.transfer.T @ x
        return x, y

    @cached_property
    def _factor(self) -> tuple[Floats, bool]:
        try:
            factor = cho_factor(self.regular(), lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            raise ObservabilityError(_UNDETERMINED) from None
        return np.asarray(factor[0], dtype=np.float64), bool(factor[1])

    def covariance(self) -> Floats:
        """Return the covariance (p s, p s) of the kept side, under the constraints."""
        return self._covariance

    @cached_property
    def _covariance(self) -> Floats:
        inverse: Floats = np.asarray(np.linalg.inv(self.regular()), dtype=np.float64)
        inverse -= self._violation(inverse @ self.constraints, inverse)
        inverse *= self.scale * self.scale[:, None]
        return np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)

    def _violation(self, response: Floats, columns: Floats) -> Floats:
        """Return what to subtract from ``columns`` to bring them on the constraints.

        ``response`` is the inverse of :meth:`regular` times the constraints (Lagrange).
        """
        multipliers = np.linalg.solve(self.constraints.T @ response, self.constraints.T @ columns)
        return response @ multipliers

    def other_blocks(self, covariance: Floats) -> Floats:
        """Return the covariance blocks (q, t, t) of the eliminated side."""
        q, t, _ = self.inverse.shape
        columns = self.transfer.T.reshape(q, t, -1)
        spread = (self.transfer.T @ covariance).reshape(q, t, -1)
        return np.asarray(self.inverse + spread @ columns.swapaxes(1, 2), dtype=np.float64)

    def other_times(self, covariance: Floats, vectors: Floats) -> Floats:
        """Return the covariance of the eliminated side times ``vectors`` (q t, c)."""
        q, t, _ = self.inverse.shape
        own = (self.inverse @ vectors.reshape(q, t, -1)).reshape(q * t, -1)
        product = own + self.transfer.T @ (covariance @ (self.transfer @ vectors))
        return np.asarray(product, dtype=np.float64)


def eliminate(
    kept: Floats, other: Floats, cross: Floats, constraints: Floats | None = None
) -> SchurComplement:
    """Eliminate the side ``other`` (q, t, t), with ``cross`` (y, q t).

    ``kept``: blocks (p, s, s) with y = p s, or one matrix (y, y). ``constraints`` (y, c): x has to
    be orthogonal to these columns, which stand in for what the data leave open. Raises
    ObservabilityError where a block of the other side is singular: such is a station from which
    all targets stand in one line.
    """
    q, t, _ = other.shape
    try:
        inverse = np.asarray(np.linalg.inv(other))
    except np.linalg.LinAlgError:
        raise ObservabilityError(_UNDETERMINED) from None
    transfer = np.empty_like(cross)
    by_block = cross.reshape(-1, q, t).swapaxes(0, 1) @ inverse
    transfer.reshape(-1, q, t)[...] = by_block.swapaxes(0, 1)
    matrix = -transfer @ cross.T
    matrix = 0.5 * (matrix + matrix.T)  # rounding leaves it a little askew
    if kept.ndim == 2:
        matrix = matrix + kept
    else:
        p, s, _ = kept.shape
        matrix.reshape(p, s, p, s)[np.arange(p), :, np.arange(p)] += kept
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), np.finfo(np.float64).tiny))
    columns = np.empty((len(matrix), 0))
    if constraints is not None:
        columns = np.linalg.qr(constraints * scale[:, None])[0]
    return SchurComplement(matrix, inverse, transfer, scale, np.asarray(columns))


@dataclass(frozen=True, eq=False)
class UnknownsLayout:
    """The places of the unknowns of m stations and s zeros, as p strips see them.

    ``index`` (p, 4): places of (X, Y, Z, d) of a strip among ``size`` unknowns; ``places`` (3 m,):
    those of all coordinates, station by station. ``first_strip`` (m,), ``first_of_zero`` (s,).
    ``tension`` (s, s): inverse covariance of zeros that wander, 1/m^2; None: they do not.
    ``walk`` (s,): as in the grid.
    """

    index: Ints
    size: int
    places: Ints
    shared: bool
    first_strip: Ints
    first_of_zero: Ints
    tension: Floats | None
    walk: Floats | None = None

    @classmethod
    def of(cls, grid: Grid) -> UnknownsLayout:
        """Return the layout of a grid."""
        m = grid.n_stations
        if grid.zero is None and grid.circle_std is None:
            index, each = np.arange(4 * m).reshape(m, 4), np.arange(m)
            return cls(index, 4 * m, index[:, :3].ravel(), False, each, each, None)
        of_station = 3 * grid.station[:, None] + np.arange(3)
        return cls(
            index=np.column_stack(
                [of_station, 3 * m + (grid.station if grid.zero is None else grid.zero)]
            ),
            size=3 * m + grid.n_zeros,
            places=np.arange(3 * m),
            shared=True,
            first_strip=grid.first_strip,
            first_of_zero=grid.first_of_zero,
            tension=None if grid.walk is None else _tension(grid.walk),
            walk=grid.walk,
        )

    def stretch(self, zeros: Floats) -> tuple[Floats, Floats]:
        """Return steps of ``zeros`` (..., s) in standard deviations, and their pull (..., s).

        From the differences: their squares would drown in those of the zeros.
        """
        assert self.walk is not None
        steps = np.diff(zeros, axis=-1) / self.walk[:-1]
        tight = steps / self.walk[:-1]
        pull = np.zeros_like(zeros)
        pull[..., :-1] -= tight
        pull[..., 1:] += tight
        return steps, pull

    def collect(self, of_strips: Floats) -> Floats:
        """Return gradients (..., p, 4) of the strips as one (..., size) of the unknowns."""
        flat = of_strips.reshape(*of_strips.shape[:-2], -1)
        if not self.shared:
            return flat
        total = np.zeros((self.size, *flat.shape[:-1]))
        np.add.at(total, self.index.ravel(), np.moveaxis(flat, -1, 0))
        return np.moveaxis(total, 0, -1)

    def gather(
        self, blocks: Floats, targets: Floats, cross: Floats, circle: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Return the normal matrix of the unknowns from blocks (p, 4, 4) and (4 p, 3 n).

        ``circle`` (c, 3 m): slopes of what else is observed of the stations, in its standard
        deviations.
        """
        kept = np.zeros((self.size, self.size))
        np.add.at(kept, (self.index[:, :, None], self.index[:, None, :]), blocks)
        if circle is not None:
            kept[np.ix_(self.places, self.places)] += circle.T @ circle
        if self.tension is not None:
            zeros = slice(len(self.places), None)
            kept[zeros, zeros] += self.tension
        # a zero that has lost all its lengths would make the matrix singular: it stays where it is
        idle = np.flatnonzero(kept.diagonal() == 0.0)
        kept[idle, idle] = 1.0
        together = np.zeros((self.size, cross.shape[1]))
        np.add.at(together, self.index.ravel(), cross)
        return kept, targets, together

    def with_zeros(self, motions: Floats) -> Floats:
        """Insert the zeros, which these motions of the stations do not change: (3 m, c)."""
        full = np.zeros((self.size, motions.shape[1]))
        full[self.places] = motions
        return full


def _tension(walk: Floats) -> Floats:
    """Return the inverse covariance (s, s) of zeros whose steps have the deviations ``walk``."""
    pull = np.append(walk[:-1] ** -2.0, 0.0)
    tension = np.diag(pull + np.roll(pull, 1))
    tension -= np.diag(pull[:-1], 1) + np.diag(pull[:-1], -1)
    return np.asarray(tension, dtype=np.float64)


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
            return eliminate(*gathered, constraints)
        if self.stations_kept:
            return eliminate(stations, targets, cross, constraints)
        return eliminate(targets, stations, np.ascontiguousarray(cross.T))

    def step(self, reduced: SchurComplement) -> tuple[Floats, Floats]:
        """Return the step of strips (p, 4) and targets (n, 3) that ``reduced`` gives."""
        return self.respond(self.station_gradient, self.target_gradient, reduced)

    def bend(self, reduced: SchurComplement, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return what a step (x, y) lacks to keep the errors linear to second order."""
        # the second derivative of a distance: the square of the step across the beam over it
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
        # a rise within 1e-9 of chi-squared is its rounding
        if trial.chi2 > network.chi2 + 1e-9 * max(network.chi2, 1.0):
            if squared < STAGNANT and damping < 2.0 * least:
                return network  # what is left to gain drowns in the rounding of chi-squared
            damping = max(10.0 * damping, least) if curved else 0.0
            curved = True
            continue
        network = trial
        if damping == 0.0:
            # chord steps shrink by a constant ratio, which foretells the step that would follow
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
        "do not fit the targets; check places and order of the targets (of a table: --targets)"
        f"{or_prior(free=grid.free)}"
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


def network_of(grid: Grid, fit: Adjustment) -> Network:
    """Return the network at the adjustment ``fit`` of ``grid``, whichever variant made it.

    A target that is taken as known gets the standard deviation KNOWN, for a finite weight.
    """
    if fit.network is not None:
        return fit.network
    known = replace(grid, target_std=np.maximum(grid.target_std, KNOWN))
    return linearise(known, fit.state, fit.targets)


def rigid(points: Floats) -> Floats:
    """Return what three shifts and three turns about the origin do to ``points``: (3 k, 6)."""
    motions = np.empty((len(points), 3, RIGID_MOTIONS))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = -cross_matrix(points)
    return motions.reshape(-1, RIGID_MOTIONS)


def less_rigid(points: Floats, moved: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Take shift and turn of all ``points`` off what they ``moved`` by, (n, 3).

    Return the rest and its standard deviations (n, 3): an S-transformation of its ``covariance``
    (3 n, 3 n).
    """
    motions = rigid(points - points.mean(axis=0))
    rest = np.eye(moved.size) - motions @ np.linalg.pinv(motions)
    variance = np.sum((rest @ covariance) * rest, axis=1)
    std = np.sqrt(np.maximum(variance, 0.0)).reshape(moved.shape)
    return (rest @ moved.ravel()).reshape(moved.shape), np.asarray(std)


def _constraints(stations: Floats, layout: UnknownsLayout) -> Floats:
    """Return what the ``stations`` (m, 3) must not do in a free network: seven columns.

    Six rigid motions, and growing away from their centroid, which is the station part of the
    seventh up to a shift. None of them changes a zero.
    """
    spread = stations - stations.mean(axis=0)
    return layout.with_zeros(np.column_stack([rigid(spread), spread.ravel()]))


@dataclass(frozen=True, eq=False)
class NetworkGain:
    """Gauss-Newton steps for many gradients at once: by the covariance of the kept side."""

    kept: Floats
    reduced: SchurComplement
    stations_kept: bool
    layout: UnknownsLayout

    @classmethod
    def of(cls, network: Network) -> NetworkGain:
        """Return the gain of a network."""
        covariance = network.reduced.covariance()
        return cls(covariance, network.reduced, network.stations_kept, network.layout)

    def step(self, station: Floats, target: Floats) -> tuple[Floats, Floats]:
        """Return the Gauss-Newton steps, to be subtracted, for gradients (t, p, 4), (t, n, 3)."""
        a, b = self.layout.collect(station), target.reshape(len(target), -1)
        kept, other = (a, b) if self.stations_kept else (b, a)
        blocks = len(self.reduced.inverse)
        x = (kept - other @ self.reduced.transfer.T) @ self.kept
        own = np.einsum("qab,tqb->tqa", self.reduced.inverse, other.reshape(len(x), blocks, -1))
        y = own.reshape(other.shape) - x @ self.reduced.transfer
        a, b = (x, y) if self.stations_kept else (y, x)
        return a[:, self.layout.index], b.reshape(target.shape)


class LengthView(ABC):
    """The linear view at a network, by the lengths of e places: their strips and targets (e,)."""

    @abstractmethod
    def leverage(self, strip: Ints, target: Ints) -> Floats:
        """Return the covariance (e, e) of the adjusted lengths, m^2."""

    @abstractmethod
    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        """Return what the outputs are off by for a unit of each length over its variance."""

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        """Return the residual cofactor of lengths of one target, with 1 / std ``unit`` (e,)."""
        leverage = self.leverage(strip, target) * unit * unit[:, None]
        return LowRank.whole(np.eye(len(unit)) - 0.5 * (leverage + leverage.T))


def view_of(network: Network, outputs: Slopes) -> LengthView:
    """Return the view at ``network``; ``outputs`` (m, 3 m): slopes by the stations."""
    if network.stations_kept or network.targets.size > len(network.state):
        return _Whole(network, outputs)
    return _Apart(network, outputs)


@dataclass(frozen=True, eq=False)
class _Whole(LengthView):
    """By the covariance of all unknowns."""

    network: Network
    outputs: Slopes

    @cached_property
    def covariance(self) -> Floats:
        """The covariance of stations and zeros, then of targets."""
        reduced = self.network.reduced
        kept = reduced.covariance()
        mixed = -(kept @ reduced.transfer)
        other = reduced.other_times(kept, np.eye(mixed.shape[1]))
        if self.network.stations_kept:
            return np.block([[kept, mixed], [mixed.T, other]])
        return np.block([[other, mixed.T], [mixed, kept]])

    @cached_property
    def carried(self) -> Floats:
        """The outputs' slopes times the covariance, (unknowns, m)."""
        return np.ascontiguousarray(
            self.outputs.times(self.covariance[self.network.layout.places]).T
        )

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        columns, values = self._rows(strip, target)
        spread = _combined(self.covariance, columns, values)
        return _combined(spread.T, columns, values)

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        return Sensitivity.whole(_combined(self.carried, *self._rows(strip, target)).T)

    def _rows(self, strip: Ints, target: Ints) -> tuple[Ints, Floats]:
        """Return the columns (e, 7) that the lengths touch, and their slopes (e, 7)."""
        slopes, layout = self.network.rows[strip, target], self.network.layout
        of_target = layout.size + 3 * target[:, None] + np.arange(3)
        columns = np.column_stack([layout.index[strip], of_target])
        return columns, np.column_stack([slopes, -slopes[:, :3]])


def _combined(matrix: Floats, columns: Ints, values: Floats) -> Floats:
    """Return sums of rows of ``matrix``: those of ``columns`` (e, k), times ``values`` (e, k)."""
    found = values[:, :1] * matrix[columns[:, 0]]
    for k in range(1, columns.shape[1]):
        found += values[:, k : k + 1] * matrix[columns[:, k]]
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class _Apart(LengthView):
    """By what each station has to itself, and the targets that all have in common.

    With stations x eliminated, B their normal blocks, K the covariance of the targets and T the
    transfer to them, cov x = B^-1 + T' K T: a length with slopes s by its station and t by its
    target is off by s'B^-1 of its own and K (t - T s) of the targets.
    """

    network: Network
    outputs: Slopes

    @cached_property
    def common(self) -> Floats:
        """What outputs feel of what all stations feel, and of the targets: (m, c + 3 n)."""
        stations = self._transfer[:, :, :3].reshape(-1, self.outputs.along.shape[1])
        return np.hstack([self.outputs.common, -self.outputs.times(stations.T)])

    @cached_property
    def _transfer(self) -> Floats:
        """T by stations, (3 n, m, 4)."""
        return self.network.reduced.transfer.reshape(-1, len(self.network.state), 4)

    def _by_target(self, strip: Ints, target: Ints) -> Floats:
        """Return t - T s, (e, 3 n)."""
        slopes = self.network.rows[strip, target]
        if (strip == strip[0]).all():
            found = -(slopes @ self._transfer[:, strip[0]].T)
        else:
            found = -np.einsum("ea,tea->et", slopes, self._transfer[:, strip])
        columns = 3 * target[:, None] + np.arange(3)
        found[np.arange(len(strip))[:, None], columns] -= slopes[:, :3]
        return np.asarray(found)

    def _by_station(self, strip: Ints, target: Ints) -> Floats:
        """Return B^-1 s, (e, 4)."""
        slopes = self.network.rows[strip, target]
        return np.asarray((self.network.reduced.inverse[strip] @ slopes[:, :, None])[:, :, 0])

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        by_target = self._by_target(strip, target)
        own = self._by_station(strip, target) @ self.network.rows[strip, target].T
        own *= strip[:, None] == strip
        return np.asarray(own + by_target @ self.network.reduced.covariance() @ by_target.T)

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        moved = self._by_station(strip, target)[:, :3]
        of_targets = self.network.reduced.covariance() @ self._by_target(strip, target).T
        columns = 3 * strip[:, None] + np.arange(3)
        shared = np.einsum("cea,ea->ce", self.outputs.along[:, columns], moved)
        at, which = np.unique(strip, return_inverse=True)
        own = np.zeros((len(at), len(strip)))
        own[which, np.arange(len(strip))] = (self.outputs.own[strip] * moved).sum(axis=1)
        return Sensitivity(np.vstack([shared, of_targets]), self.common, at, own)

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        slopes = self.network.rows[strip, target]
        own = (self._by_station(strip, target) * slopes).sum(axis=1) * unit**2
        columns = self._by_target(strip, target) * unit[:, None]
        values, axes = np.linalg.eigh(self.network.reduced.covariance())
        root = axes * np.sqrt(np.maximum(values, 0.0))
        return LowRank((1.0 - own)[:, None, None], columns @ root, -np.eye(len(root)))
