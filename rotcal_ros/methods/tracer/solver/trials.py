"""What a problem would give: the covariance of a plan, and Monte Carlo trials of a measurement.

A plan needs no data: :func:`predicted` is the solver's own covariance on the nominal geometry.

Trials are vectorised, hundreds of solutions in one go, and every one is solved to the end:
Gauss-Newton with the exact gradient; only the normal matrix is that of the measurement for all of
them. Its error is of the order of noise over distance (1e-5): a few steps leave nothing but
rounding. A trial that does not settle so, as some of a free network with weak geometry, is solved
alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.tracer.solver.adjustment import (
    StationCovariance,
    adjust_stations,
    stations_covariance,
)
from rotcal_ros.methods.tracer.solver.circle import (
    CircleContrasts,
    circle_contrasts,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.joint import adjust_network, network_covariance
from rotcal_ros.methods.tracer.solver.network import NetworkGain, network_of, relax
from rotcal_ros.methods.tracer.solver.observability import check_counts
from rotcal_ros.methods.tracer.solver.problem import Grid, TracerProblem, arrange
from rotcal_ros.methods.tracer.solver.solution import TracerSolution
from rotcal_ros.methods.tracer.solver.uncertainty import AngleUncertainty, angle_uncertainty
from rotcal_ros.methods.tracer.solver.zeros import Slips, shift_search, slips_among

STEPS: Final = 3
"""Each step leaves 1e-5 of the error before it: from noise of 1e-6 m, two reach rounding."""
MOST_STEPS: Final = 6
"""Twice as many for a network; what has not settled then is quicker solved alone."""
SETTLED: Final = 1e-10
"""Squared length, in standard deviations, of a last step that left nothing to do."""
PLACES: Final = 200_000
"""Lengths of all trials of a chunk together: arrays of this size stay in the cache."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a problem would give: ``angles`` holds the covariance (m, m) of ECC in rad^2.

    ``redundancy`` (k,) by row of the problem; NaN for lengths that have no place on its grid.
    ``stations``: their covariance, as in a solution.
    """

    stations: StationCovariance
    angles: AngleUncertainty
    redundancy: Floats


def predicted(problem: TracerProblem, stations: Floats) -> Prediction:
    """Return what ``problem`` would give with its tracer at ``stations`` (one per table angle, m).

    Its lengths do not matter: exact ones take their place. Noise is as stated, and nothing is
    rejected. The table's error motion is taken as stated, None as none.

    Raises ObservabilityError when the lengths are too few or leave a direction open.
    """
    apart = stations[problem.position] - problem.targets[problem.target]
    exact = replace(problem, length=np.sqrt((apart**2).sum(axis=1)))
    grid, _ = arrange(exact)
    check_counts(grid)
    standing = stations[grid.position_ids][grid.station]
    start = np.column_stack([standing, np.zeros(len(standing))])
    if problem.variant == "joint":
        fit = adjust_network(grid, start, grid.targets)
        covariance = network_covariance(grid, fit)
    else:
        fit = adjust_stations(grid, start)
        covariance = stations_covariance(grid, fit)
    motion = table_motion(fit.stations, problem.table_angles[grid.position_ids])
    error_motion = problem.error_motion_std or 0.0
    shared = grid.zero is not None
    shifts = shift_search(grid, fit, problem.measuring_order).few() if shared else None
    slips = slips_among(shifts, problem.slip, problem.settings.rejection_significance)
    unseen = None if slips is None else slips.covariance()
    angles = angle_uncertainty(motion, fit.stations, covariance, error_motion, 1.0, unseen)
    redundancy = np.full(len(problem.position), np.nan)
    placed = grid.row >= 0
    redundancy[grid.row[placed]] = fit.redundancy[placed]
    return Prediction(covariance, angles, redundancy)


@dataclass(frozen=True, eq=False)
class TracerTrials:
    """Draws measurements like the given one and solves them; made by :func:`trials_about`.

    ``state`` (p, 4) and ``targets`` (n, 3) are the solution, ``weights`` (p, n) those of the
    solver. ``gain`` belongs to its variant; for "station" the inverse normal matrices (m, 4, 4).
    ``scale`` enlarges the stated noise as the solver does, ``wobble`` (2, 3) are standard error
    motions in the plane of the stations, over these by ``along`` (m, r). ``zeros`` (r, m, n):
    standard errors that all lengths of a run have in common (m), ``slips`` those that stay unseen.
    ``circle``: contrasts of a stated circle about the solution.
    """

    grid: Grid
    angles: Floats
    state: Floats
    targets: Floats
    weights: Floats
    scale: float
    wobble: Floats
    along: Floats
    zeros: Floats
    gain: Floats | NetworkGain
    circle: CircleContrasts | None = None
    slips: Slips | None = None

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the cumulative deviations (count, m) in rad of simulated measurements."""
        size = max(1, PLACES // self.weights.size)
        parts = []
        for done in range(0, count, size):
            number = min(size, count - done)
            drawn = self.draw(rng, number)
            parts.append(self.solve(*drawn, self.draw_circle(rng, number)))
        return np.concatenate(parts)

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
        """Return lengths (count, m, n), machine coordinates (count, n, 3), wobble (count, m, 3).

        The measured values with fresh noise.
        """
        grid = self.grid
        m, n = grid.used.shape
        length = grid.length + self.scale * grid.length_std * rng.standard_normal((count, m, n))
        if grid.walk is not None:
            length += _walks(grid.walk, rng, count)[:, grid.zero, None]
        if self.slips is not None:
            length += self.slips.draw(grid, rng, count)
        if len(self.zeros):
            length += np.tensordot(rng.standard_normal((count, len(self.zeros))), self.zeros, 1)
        places = rng.standard_normal((count, n, 3))
        targets = grid.targets + self.scale * grid.target_std * places
        drawn = rng.standard_normal((count, self.along.shape[1], 2))
        wobble = self.along @ drawn @ self.wobble
        return length, targets, wobble

    def draw_circle(self, rng: np.random.Generator, count: int) -> Floats | None:
        """Return what the stated circle's contrasts (count, c) are held to be, m; none without."""
        if self.circle is None:
            return None
        std = self.scale * (self.grid.circle_std or 0.0)
        return std * rng.standard_normal((count, len(self.circle.value)))

    def solve(
        self, length: Floats, places: Floats, wobble: Floats, circle: Floats | None = None
    ) -> Floats:
        """Return the cumulative deviations (t, m) for t sets of what :meth:`draw` returns.

        ``circle``: what :meth:`draw_circle` returns; none: as stated.
        """
        state = np.broadcast_to(self.state, (len(length), *self.state.shape)).copy()
        if isinstance(self.gain, NetworkGain):
            self._settle(self.gain, state, length, places, circle)
        else:
            for _ in range(STEPS):
                by_station, _ = self._gradients(state, places, length)
                state -= (self.gain @ by_station[..., None])[..., 0]
        stations = state[:, self.grid.first_strip, :3]
        return cumulative_deviations(stations + wobble, self.angles)

    def _settle(
        self,
        gain: NetworkGain,
        state: Floats,
        length: Floats,
        places: Floats,
        circle: Floats | None,
    ) -> None:
        """Bring the stations ``state`` (t, m, 4) of networks to their minimum, in place."""
        targets = np.broadcast_to(self.targets, places.shape).copy()
        for _ in range(MOST_STEPS):
            by_station, by_target = self._gradients(state, targets, length)
            if (layout := gain.layout).tension is not None:
                _, pull = layout.stretch(state[:, layout.first_of_zero, 3])
                by_station[:, layout.first_of_zero, 3] += pull
            if self.circle is not None:
                by_station[:, self.grid.first_strip, :3] += self._circle_pull(state, circle)
            if not self.grid.free:
                by_target += (targets - places) / self.grid.target_std**2
            steps = gain.step(by_station, by_target)
            state -= steps[0]
            targets -= steps[1]
            left = (by_station * steps[0]).sum(axis=(1, 2))
            left += (by_target * steps[1]).sum(axis=(1, 2))
            if (open_ := ~(np.abs(left) < SETTLED)).sum() == 0:
                break
        for t in np.flatnonzero(open_):
            grid = replace(self.grid, length=length[t], targets=places[t])
            state[t] = relax(grid, self.state, self.targets).state

    def _circle_pull(self, state: Floats, held: Floats | None) -> Floats:
        """Return the circle's pull (t, m, 3) on stations, linear about the solution."""
        assert self.circle is not None
        assert self.grid.circle_std is not None
        first = self.grid.first_strip
        moved = (state - self.state)[:, first, :3].reshape(len(state), -1)
        off = self.circle.value + moved @ self.circle.slope.T
        if held is not None:
            off = off - held
        pull = off @ self.circle.slope / self.grid.circle_std**2
        return np.asarray(pull.reshape(len(state), -1, 3))

    def _gradients(self, state: Floats, targets: Floats, length: Floats) -> tuple[Floats, Floats]:
        """Return half the slope of chi-squared for stations (t, m, 4) and targets (t, n, 3)."""
        difference = state[:, :, None, :3] - targets[:, None]
        distance = np.sqrt(np.einsum("tjia,tjia->tji", difference, difference))
        pull = self.weights * (distance - state[:, :, 3:] - length)
        push = difference * (pull / distance)[..., None]
        by_station = np.concatenate([push.sum(axis=2), -pull.sum(axis=2)[..., None]], axis=2)
        return by_station, -push.sum(axis=1)


def _walks(std: Floats, rng: np.random.Generator, count: int) -> Floats:
    """Return walks (count, s) of zeros with these standard deviations to the next; 0 at begins."""
    linked = np.isfinite(std)
    steps = np.where(linked, std, 0.0) * rng.standard_normal((count, len(std)))
    total = np.cumsum(steps, axis=1) - steps
    chain = np.append(0, np.cumsum(~linked)[:-1])
    begin = np.unique(chain, return_index=True)[1]
    return np.asarray(total - total[:, begin][:, chain], dtype=np.float64)


def trials_about(solution: TracerSolution) -> TracerTrials:
    """Prepare Monte Carlo trials about a solved problem.

    Rejected lengths stay rejected. The output quantities are the deviations ECC of the result.
    """
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    weights = grid.used / fit.std**2
    gain: Floats | NetworkGain
    if problem.variant == "joint":
        network = network_of(grid, fit)
        gain = NetworkGain.of(network)
    else:
        difference = fit.stations[:, None] - fit.targets
        unit = difference / np.linalg.norm(difference, axis=2, keepdims=True)
        design = np.concatenate([unit, -np.ones((*unit.shape[:2], 1))], axis=2)
        normal = design.swapaxes(1, 2) @ (design * weights[..., None])
        gain = np.linalg.inv(normal)
    return TracerTrials(
        grid=grid,
        angles=solution.table_angles,
        state=fit.state,
        targets=fit.targets,
        weights=weights,
        scale=solution.scale,
        wobble=solution.error_motion.used * solution.motion.plane.basis(),
        along=solution.spectrum.root(solution.table_angles),
        zeros=np.zeros((0, *grid.used.shape)),
        gain=gain,
        circle=None if grid.circle_std is None else circle_contrasts(fit.stations),
        slips=solution.slips,
    )


def cumulative_deviations(stations: Floats, angles: Floats) -> Floats:
    """Return the cumulative deviations (..., m) in rad for ``stations`` (..., m, 3).

    The same as :func:`~rotcal_ros.methods.tracer.solver.circle.table_motion` for many sets of
    stations at once. The normal comes from the 3 by 3 moments: what their squares lose of it is of
    second order for the angles.
    """
    centred = stations - stations.mean(axis=-2, keepdims=True)
    _, axes = np.linalg.eigh(centred.swapaxes(-1, -2) @ centred)
    normal = axes[..., 0] * np.where(axes[..., 2, 0] < 0.0, -1.0, 1.0)[..., None]
    first = np.array([1.0, 0.0, 0.0]) - normal[..., :1] * normal
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    basis = np.stack([first, np.cross(normal, first)], axis=-1)
    flat = centred @ basis
    squares = 0.5 * (flat * flat).sum(axis=-1, keepdims=True)
    across = flat.swapaxes(-1, -2)
    offset = np.linalg.solve(across @ flat, across @ squares)
    arm = flat - offset.swapaxes(-1, -2)
    excess = np.arctan2(arm[..., 1], arm[..., 0]) - angles
    return wrap_angle(excess - excess[..., :1])
