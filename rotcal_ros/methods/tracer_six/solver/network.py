"""Table, places and targets as one network of lengths: its minimum, and what follows from it.

A station is R_i q_k + t_i, with the pose (R_i, t_i) of the table's frame at a position and the
place q_k in that frame. Scatter from arrival to arrival moves it by e ~ N(0, S) and is
integrated out, so that the lengths of a station have the covariance D + U S U'; its inverse is
W = D^-1 - H H' with H (n, 3). Poses, six unknowns each, are eliminated; targets, places and zeros
are kept.

What no length feels is fixed by constraints. Right motions: the table's own frame may lie
anywhere, q -> W q + w with the poses to match. Left motions: without a prior on the targets the
whole network may, too. And with free targets, places at one height on one circle about the axis
leave a seventh: targets and circle as in :mod:`~..lengths.joint`. None of them is felt by the
curves.

Places that cannot determine the table's tilts need a prior: the tilt c_i of each position, less
what both frames contribute, u + Rz w with four unknowns (u, w), is an observation of zero with the
standard deviation ``tilt_std``; in a trial it is one of what chance has drawn.

About the minimum follow the covariances of all unknowns, stations and lengths, and to first order
what a pattern of errors of the lengths does.

The six curves follow from the poses in the gauge that all methods share. With
R_i = U R(c_i) Rz(theta_i) Q' and R_i o + t_i = v + U d_i the axis stands at v, turned by U, in the
machine; the table's own frame lies at o, turned by Q. U has no turn about z, v no height: x
points to the machine's x, heights count from its z = 0. The other ten are chosen so that nothing
of a motion of either frame is left in the curves: sum c = sum d = 0, and in x and y also
sum Rz' c = sum Rz' d = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.problem import Grid
from rotcal_ros.methods.tracer_six.lengths.network import SchurComplement, rigid
from rotcal_ros.methods.tracer_six.solver.problem import StationLayout

GAUGE_STEPS: Final = 20
"""Steps to the gauge; each takes off all but the second order."""
ROUNDING: Final = 1e-15
"""Motion of the frames (rad or m) that is none."""
TOO_FAR: Final = 0.05
"""Deviation (rad) from the commanded angles that no table has."""


@dataclass(frozen=True, eq=False)
class Curves:
    """``translation`` (m, 3) m, ``rotation`` (m, 3) rad; the frames they are counted in.

    ``axes`` U (3, 3) and ``origin`` v (3,) m: the axis in the machine; ``table_turn`` Q (3, 3) and
    ``table_origin`` o (3,) m: the same in the frame of the places.
    """

    translation: Floats
    rotation: Floats
    axes: Floats
    origin: Floats
    table_turn: Floats
    table_origin: Floats


def table_curves(rotation: Floats, translation: Floats, angles: Floats) -> Curves:
    """Return the curves of poses ``rotation`` (m, 3, 3), ``translation`` (m, 3) at ``angles``.

    Raises DataError when the poses do not follow the angles.
    """
    axes, origin = np.eye(3), np.zeros(3)
    turn, place = np.eye(3), np.zeros(3)
    about = rotation_about_z(angles)
    _, in_plane = gauge_design(angles)
    for _ in range(GAUGE_STEPS):
        c = rotation_vector(axes.T @ rotation @ turn @ about.swapaxes(1, 2))
        d = (rotation @ place + translation - origin) @ axes
        tilt, turned = in_plane @ c[:, :2].ravel(), float(c[:, 2].mean())
        shift, height = in_plane @ d[:, :2].ravel(), float(d[:, 2].mean())
        if np.abs([*tilt, *shift, turned, height]).max() < ROUNDING:
            break
        # to first order c gains u + Rz w, d gains v + Rz o, from motions of both frames
        axes = axes @ rotation_from_vector([tilt[0], tilt[1], 0.0])
        axes = axes @ rotation_from_vector([0.0, 0.0, -_heading(axes)])
        turn = turn @ rotation_from_vector([-tilt[2], -tilt[3], -turned])
        origin = origin + axes[:, :2] @ shift[:2]
        origin = origin - axes[:, 2] * (origin[2] / axes[2, 2])
        place = place - turn @ np.array([shift[2], shift[3], height])
    _check(c, angles)
    return Curves(d, c, axes, origin, turn, place)


def gauge_design(angles: Floats) -> tuple[Floats, Floats]:
    """Return what both frames do to x and y at all angles, (2 m, 4), and its inverse (4, 2 m)."""
    about = rotation_about_z(angles)[:, :2, :2]
    upright = np.broadcast_to(np.eye(2), about.shape)
    design = np.concatenate([upright, about], axis=2).reshape(-1, 4)
    return design, np.asarray(np.linalg.pinv(design), dtype=np.float64)


def _without_gauge(angles: Floats) -> Floats:
    """Return the projection (3 m, 3 m) that takes the motions of both frames off d or c."""
    m = len(angles)
    design, inverse = gauge_design(angles)
    plane = np.eye(2 * m) - design @ inverse
    whole = np.zeros((m, 3, m, 3))
    whole[:, :2, :, :2] = plane.reshape(m, 2, m, 2)
    whole[:, 2, :, 2] = np.eye(m) - 1.0 / m
    return whole.reshape(3 * m, 3 * m)


def curve_jacobian(curves: Curves, rotation: Floats, angles: Floats) -> Floats:
    """Return (6 m, 6 m): what pose steps (a turn, then a shift, of each) do to d and c.

    Rows are the d (3 m) of all positions, then the c.
    """
    m = len(angles)
    arms = rotation @ curves.table_origin
    own = np.zeros((2, m, 3, m, 6))
    each = np.arange(m)
    back = np.broadcast_to(curves.axes.T, (m, 3, 3))
    own[0, each, :, each, :3] = -back @ cross_matrix(arms)
    own[0, each, :, each, 3:] = back
    own[1, each, :, each, :3] = log_slope(curves.rotation) @ back
    project = _without_gauge(angles)
    return np.concatenate([project @ part.reshape(3 * m, 6 * m) for part in own])


def rotation_vector(matrices: Floats) -> Floats:
    """Return the vectors (..., 3), rad, that turn like ``matrices``; below a quarter turn."""
    odd = 0.5 * (matrices - np.swapaxes(matrices, -1, -2))
    vector = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1)
    sine = np.minimum(np.linalg.norm(vector, axis=-1), 1.0)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrices, axis1=-2, axis2=-1) - 1.0))
    # angle / sine is 1 + angle^2 / 6: beyond the last digit
    tiny = sine < 1e-8
    stretch = np.where(tiny, 1.0, angle / np.where(tiny, 1.0, sine))
    return np.asarray(vector * stretch[..., None], dtype=np.float64)


def log_slope(vectors: Floats) -> Floats:
    """Return (..., 3, 3): how the rotation vector changes with a small turn from the left.

    Up to the fourth order of the vector; rad.
    """
    k = cross_matrix(vectors)
    return np.asarray(np.eye(3) - 0.5 * k + (k @ k) / 12.0, dtype=np.float64)


def _heading(axes: Floats) -> float:
    """Return the turn about z of a rotation that is nearly one about x and y."""
    return float(np.arctan2(axes[1, 0] - axes[0, 1], axes[0, 0] + axes[1, 1]))


def _check(c: Floats, angles: Floats) -> None:
    size = np.linalg.norm(c, axis=1)
    worst = int(np.argmax(size))
    if not size[worst] < TOO_FAR:
        raise DataError(
            f"the table turned {np.degrees(size[worst]):.3g} degrees off at the commanded angle "
            f"{np.degrees(angles[worst]):g} degrees: check that the angles are counter-clockwise, "
            "in the right unit and in the order of the positions, that the machine's z is along "
            "the axis, and that its frame is right-handed"
        )


CONVERGED: Final = 1e-14
"""Squared length of the last step in standard deviations."""
STAGNANT: Final = 1e-6
"""Squared length below which a step that no longer shrinks is rounding."""
SHRINKING: Final = 1e-4
"""Ratio of squared steps above which the normal matrix is made anew."""
MAX_ITERATIONS: Final = 60
"""Most chord steps, each with the present slopes."""
FLAT: Final = 1e-4
"""Difference of the places' heights and radii (m) up to which they lie on one circle: what they
then show of the flex is below any noise."""


class TiltSlopes(NamedTuple):
    """What the prior adds to chi-squared and to half its slopes, poses (m, 6) and lean (4,)."""

    chi2: float
    poses: Floats
    lean: Floats


def _tilts(rotation: Floats, angles: Floats) -> Floats:
    return rotation_vector(rotation @ rotation_about_z(-angles))


def _tilt_slopes(rotation: Floats, lean: Floats, layout: StationLayout) -> TiltSlopes:
    """Return what the prior adds at poses ``rotation`` (m, 3, 3) and ``lean`` (4,) rad."""
    std = layout.tilt_std
    assert std is not None
    design, _ = gauge_design(layout.angles)
    vector = _tilts(rotation, layout.angles)
    expected = (design @ lean).reshape(-1, 2)
    if layout.tilts is not None:
        expected = expected + layout.tilts
    error = (vector[:, :2] - expected) / std
    slope = log_slope(vector)[:, :2]
    poses = np.zeros((len(vector), 6))
    poses[:, :3] = (error[:, None] @ slope)[:, 0] / std
    return TiltSlopes(float((error**2).sum()), poses, -design.T @ error.ravel() / std)


def _with_tilts(
    poses: Floats, cross: Floats, matrix: Floats, rotation: Floats, layout: StationLayout
) -> tuple[Floats, Floats]:
    """Return the normal matrices of poses (m, 6, 6) and (m, 6, K) with the prior.

    ``matrix`` (K, K), whose last four are the lean, is changed in place.
    """
    assert layout.tilt_std is not None
    weight = layout.tilt_std**-2
    design, _ = gauge_design(layout.angles)
    slope = log_slope(_tilts(rotation, layout.angles))[:, :2]
    back = weight * slope.swapaxes(1, 2)
    poses, cross = poses.copy(), cross.copy()
    poses[:, :3, :3] += back @ slope
    cross[:, :3, -4:] -= back @ design.reshape(-1, 2, 4)
    matrix[-4:, -4:] += weight * design.T @ design
    return poses, cross


@dataclass(frozen=True, eq=False)
class NetworkState:
    """Poses ``rotation`` (m, 3, 3), ``translation`` (m, 3), ``places`` (p, 3), ``zeros`` (s,).

    ``targets`` (n, 3). ``lean`` (4,), rad: mean tilt of the table in the machine, and in the
    table's frame; only where tilts are known beforehand. Metres.
    """

    rotation: Floats
    translation: Floats
    places: Floats
    zeros: Floats
    targets: Floats
    lean: Floats

    def stations(self, layout: StationLayout) -> Floats:
        """Return where the stations (V, 3) of ``layout`` are without scatter, m."""
        return self.arms(layout) + self.translation[layout.position]

    def arms(self, layout: StationLayout) -> Floats:
        """Return R q (V, 3) of all stations, m."""
        turned = self.rotation[layout.position] @ self.places[layout.place][:, :, None]
        return np.asarray(turned[:, :, 0], dtype=np.float64)

    def moved(self, kept: Floats, poses: Floats) -> NetworkState:
        """Return the state after a step: ``kept`` (K,) unknowns, ``poses`` (m, 6)."""
        a, b = self.targets.size, self.targets.size + self.places.size
        c = b + len(self.zeros)
        return NetworkState(
            rotation=rotation_from_vector(poses[:, :3]) @ self.rotation,
            translation=self.translation + poses[:, 3:],
            places=self.places + kept[a:b].reshape(-1, 3),
            zeros=self.zeros + kept[b:c],
            targets=self.targets + kept[:a].reshape(-1, 3),
            lean=self.lean + kept[c:] if len(self.lean) else self.lean,
        )


@dataclass(frozen=True, eq=False)
class ChiSquaredSlope:
    """Errors of a state and half the slope of chi-squared.

    ``error`` (V, n): computed - observed, m; ``unit`` (V, n, 3): from target to station;
    ``factor`` (V, n, 3): H, None without scatter; ``poses`` (m, 6), ``kept`` (K,).
    """

    error: Floats
    unit: Floats
    factor: Floats | None
    chi2: float
    poses: Floats
    kept: Floats


@dataclass(frozen=True, eq=False)
class LengthNetwork:
    """A network at its minimum, or at one step of the way there.

    ``motion`` (V, 3, 6): what the six unknowns of a pose do to its station; ``pull`` (V, 3, n):
    U' W; ``normal`` (V, 3, 3): U' W U; ``across`` (V, 3, K): the same between a station and the
    kept unknowns; ``reduced``: kept are targets, places, zeros and lean, eliminated the poses.
    """

    grid: Grid
    layout: StationLayout
    scatter: Floats | None
    state: NetworkState
    slopes: ChiSquaredSlope
    motion: Floats
    pull: Floats
    normal: Floats
    across: Floats
    reduced: SchurComplement


def slopes(
    grid: Grid, layout: StationLayout, scatter: Floats | None, state: NetworkState
) -> ChiSquaredSlope:
    """Return errors and slopes at ``state``.

    ``scatter`` (V, 3, 3): root L of the covariance S = L L' of each station, m.
    """
    arms = state.arms(layout)
    difference = (arms + state.translation[layout.position])[:, None] - state.targets
    distance = np.sqrt((difference * difference).sum(axis=2))
    unit = difference / distance[:, :, None]
    error = distance - grid.length - state.zeros[layout.zero]
    weights = grid.weights
    factor = _factor(weights, unit, scatter)
    weighted = weights * error
    if factor is not None:
        weighted -= (factor @ (factor.swapaxes(1, 2) @ error[:, :, None]))[:, :, 0]
    chi2 = float((weighted * error).sum())
    push = unit * weighted[:, :, None]
    at_station = push.sum(axis=1)
    # a force at a station turns the table by its moment about the origin of the pose
    own = np.concatenate([np.cross(arms, at_station), at_station], axis=1)
    poses = layout.by_position @ own
    turned = (at_station[:, None] @ state.rotation[layout.position])[:, 0]
    n_seen, by_pair = layout.pairs[1], layout.pairs[2]
    zeros = np.bincount(n_seen, by_pair @ weighted.ravel(), minlength=layout.n_zeros)
    by_target = -push.sum(axis=0)
    if not grid.free:
        correction = (state.targets - grid.targets) / grid.target_std
        chi2 += float((correction * correction).sum())
        by_target = by_target + correction / grid.target_std
    kept = [by_target.ravel(), (layout.by_place @ turned).ravel(), -zeros]
    if layout.tilt_std is not None:
        known = _tilt_slopes(state.rotation, state.lean, layout)
        chi2, poses = chi2 + known.chi2, poses + known.poses
        kept.append(known.lean)
    return ChiSquaredSlope(error, unit, factor, chi2, poses, np.concatenate(kept))


def _factor(weights: Floats, unit: Floats, scatter: Floats | None) -> Floats | None:
    """Return H (V, n, 3): D^-1 U L (1 + L' U' D^-1 U L)^-1/2."""
    if scatter is None:
        return None
    spread = unit @ scatter
    weighted = weights[:, :, None] * spread
    inner = np.linalg.inv(np.eye(3) + spread.swapaxes(1, 2) @ weighted)
    return np.asarray(weighted @ np.linalg.cholesky(inner), dtype=np.float64)


def linearise(
    grid: Grid,
    layout: StationLayout,
    scatter: Floats | None,
    state: NetworkState,
    here: ChiSquaredSlope,
) -> LengthNetwork:
    """Return the network at ``state``, with its slopes ``here`` and the reduced normal matrix."""
    unit, weights = here.unit, grid.weights
    pull = (unit * weights[:, :, None]).swapaxes(1, 2)
    if here.factor is not None:
        pull = pull - (unit.swapaxes(1, 2) @ here.factor) @ here.factor.swapaxes(1, 2)
    normal = pull @ unit
    motion = np.empty((len(unit), 3, 6))
    motion[:, :, :3] = -cross_matrix(state.arms(layout))
    motion[:, :, 3:] = np.eye(3)
    across = _across(layout, unit, pull, normal @ state.rotation[layout.position])
    backward = motion.swapaxes(1, 2)
    poses = _summed(layout.by_position, backward @ (normal @ motion))
    cross = _summed(layout.by_position, backward @ across)
    matrix = _kept_matrix(grid, layout, state, here, across)
    if layout.tilt_std is not None:
        poses, cross = _with_tilts(poses, cross, matrix, state.rotation, layout)
    reduced = _reduced(poses, cross, matrix, constraints(layout, state, free=grid.free))
    return LengthNetwork(grid, layout, scatter, state, here, motion, pull, normal, across, reduced)


def _summed(sums: Floats, blocks: Floats) -> Floats:
    """Add up blocks (V, a, b) of stations to (m, a, b)."""
    total = sums @ blocks.reshape(len(blocks), -1)
    return np.asarray(total.reshape(-1, *blocks.shape[1:]), dtype=np.float64)


def _across(layout: StationLayout, unit: Floats, pull: Floats, turned: Floats) -> Floats:
    """Return (V, 3, K): the normal matrix between a station and the kept unknowns."""
    v, n, _ = unit.shape
    across = np.zeros((v, 3, layout.size))
    # the slopes of an error by a target and by a zero are -u and -1
    across[:, :, : 3 * n] = -(pull[:, :, :, None] * unit[:, None]).reshape(v, 3, 3 * n)
    columns = 3 * (n + layout.place)[:, None] + np.arange(3)
    across[np.arange(v)[:, None], :, columns] = turned.swapaxes(1, 2)
    station, zero, by_pair = layout.pairs
    first = 3 * (n + len(layout.places))
    across[station, :, first + zero] = -(by_pair @ pull.swapaxes(1, 2).reshape(v * n, 3))
    return across


def _kept_matrix(
    grid: Grid, layout: StationLayout, state: NetworkState, here: ChiSquaredSlope, across: Floats
) -> Floats:
    """Return the normal matrix (K, K) of targets, places, zeros and lean."""
    v, n, _ = here.unit.shape
    a, b = 3 * n, 3 * (n + len(layout.places))
    c = b + layout.n_zeros
    matrix = np.zeros((layout.size, layout.size))
    weighted = here.unit * grid.weights[:, :, None]
    blocks = weighted.transpose(1, 2, 0) @ here.unit.swapaxes(0, 1)
    if not grid.free:
        blocks[:, [0, 1, 2], [0, 1, 2]] += grid.target_std**-2
    each = np.arange(n)
    matrix[:a, :a].reshape(n, 3, n, 3)[each, :, each] = blocks
    back = state.rotation[layout.position].swapaxes(1, 2) @ across
    matrix[a:b] = _summed(layout.by_place, back).reshape(b - a, -1)
    matrix[:a, a:b], matrix[b:c, a:b] = matrix[a:b, :a].T, matrix[a:b, b:c].T
    sums = layout.by_zero_and_target @ np.column_stack(
        [weighted.reshape(v * n, 3), grid.weights.ravel()]
    )
    sums = sums.reshape(layout.n_zeros, n, 4)
    matrix[b:c, :a] = sums[:, :, :3].reshape(-1, a)
    matrix[b:c, b:c] = np.diag(sums[:, :, 3].sum(axis=1))
    if here.factor is not None:
        low = _low_rank(layout, here)
        both = np.r_[0:a, b:c]
        matrix[np.ix_(both, both)] -= low @ low.T
    matrix[:a, b:c] = matrix[b:c, :a].T
    return matrix


def _low_rank(layout: StationLayout, here: ChiSquaredSlope) -> Floats:
    """Return what H does to targets and zeros, (3 n + s, 3 V); the signs of both cancel."""
    assert here.factor is not None
    v, n, _ = here.unit.shape
    targets = here.unit[:, :, :, None] * here.factor[:, :, None]  # (V, n, 3, 3)
    station, zero, by_pair = layout.pairs
    zeros = np.zeros((layout.n_zeros, v, 3))
    zeros[zero, station] = by_pair @ here.factor.reshape(v * n, 3)
    columns = targets.transpose(1, 2, 0, 3).reshape(3 * n, 3 * v)
    return np.concatenate([columns, zeros.reshape(-1, 3 * v)])


def _reduced(poses: Floats, cross: Floats, matrix: Floats, gauge: Floats) -> SchurComplement:
    """Eliminate the poses (m, 6, 6); ``cross`` (m, 6, K), ``matrix`` (K, K)."""
    size = matrix.shape[0]
    inverse = np.linalg.inv(poses)
    flat = cross.reshape(-1, size)
    transfer = (inverse @ cross).reshape(-1, size).T
    schur = matrix - transfer @ flat
    schur = 0.5 * (schur + schur.T)
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), np.finfo(np.float64).tiny))
    columns = np.asarray(np.linalg.qr(gauge * scale[:, None])[0], dtype=np.float64)
    return SchurComplement(schur, np.asarray(inverse), transfer, scale, columns)


def relax(
    grid: Grid, layout: StationLayout, scatter: Floats | None, state: NetworkState
) -> LengthNetwork:
    """Return the least-squares network near ``state``.

    Chord steps: Gauss-Newton with the normal matrix of the start, as long as its steps shrink
    fast, and the slopes of now. Start values are good to some micrometres, so that two or three
    steps reach rounding. Raises DataError when it does not settle.
    """
    here, before = slopes(grid, layout, scatter, state), np.inf
    network = linearise(grid, layout, scatter, state, here)
    for _ in range(MAX_ITERATIONS):
        kept, poses = network.reduced.solve(-here.kept, -here.poses.ravel())
        squared = -float(here.kept @ kept + here.poses.ravel() @ poses)
        # a step that shrinks by less than half is no longer progress but rounding
        if abs(squared) < CONVERGED or (abs(squared) < STAGNANT and squared > 0.25 * before):
            return linearise(grid, layout, scatter, state, here)
        if abs(squared) > SHRINKING * before:
            network = linearise(grid, layout, scatter, state, here)
            kept, poses = network.reduced.solve(-here.kept, -here.poses.ravel())
        state = state.moved(kept, poses.reshape(-1, 6))
        here, before = slopes(grid, layout, scatter, state), squared
    raise DataError(
        f"table, places and targets do not settle together in {MAX_ITERATIONS} iterations: the "
        "lengths do not fit the targets or the places; check their order and units (of a "
        "table: --targets)"
    )


def constraints(layout: StationLayout, state: NetworkState, *, free: bool) -> Floats:
    """Return the kept part (K, c) of all motions that no length feels.

    Poses follow by the lengths; what moves no kept unknown cannot be open.
    """
    n, p, s = len(state.targets), len(state.places), len(state.zeros)
    tilts = len(state.lean)
    right = np.zeros((3 * n + 3 * p + s + tilts, 6))
    right[3 * n : 3 * (n + p)] = rigid(state.places)
    if tilts:
        right[-2:, 3:5] = -np.eye(2)
    if not free:
        return right
    left = np.zeros_like(right)
    left[: 3 * n] = rigid(state.targets)
    if tilts:
        left[-4:-2, 3:5] = np.eye(2)
    flex = _flex(layout, state)
    return np.concatenate([right, left, *([] if flex is None else [flex[:, None]])], axis=1)


def _flex(layout: StationLayout, state: NetworkState) -> Floats | None:
    """Return the kept part (K,) of the seventh motion, None where the places do not leave it."""
    curves = table_curves(state.rotation, state.translation, layout.angles)
    places = (state.places - curves.table_origin) @ curves.table_turn
    radius = np.hypot(places[:, 0], places[:, 1])
    if np.ptp(radius) > FLAT or np.ptp(places[:, 2]) > FLAT:
        return None
    height = places[:, 2].mean()
    targets = (state.targets - curves.origin) @ curves.axes - [0.0, 0.0, height]
    bend = (targets[:, :2] ** 2).sum(axis=1) - radius.mean() ** 2
    moved = np.column_stack([targets[:, :2], -bend / targets[:, 2]])
    flex = np.zeros(layout.size)
    n, p = len(targets), len(places)
    flex[: 3 * n] = (moved @ curves.axes.T).ravel()
    shrunk = np.column_stack([-places[:, :2], np.zeros(p)])
    flex[3 * n : 3 * (n + p)] = (shrunk @ curves.table_turn.T).ravel()
    return flex


@dataclass(frozen=True, eq=False)
class PatternGradient:
    """Patterns (k, V, n), m, in a network: ``weighted`` (k, V, n) by the inverse covariance.

    ``force`` (k, V, 3): their pull at each station; ``slope`` (k, T): at all unknowns, half the
    slope of chi-squared.
    """

    weighted: Floats
    force: Floats
    slope: Floats


def pattern_gradient(network: LengthNetwork, patterns: Floats | Bools) -> PatternGradient:
    """Return ``patterns`` (k, V, n) of errors of the lengths, m, as ``network`` feels them."""
    layout, here, (k, _, n) = network.layout, network.slopes, patterns.shape
    weighted = network.grid.weights * patterns
    if here.factor is not None:
        taken = here.factor.swapaxes(1, 2) @ patterns[..., None]
        weighted = weighted - (here.factor @ taken)[..., 0]
    force = (here.unit * weighted[..., None]).sum(axis=2)  # (k, V, 3)
    poses = layout.by_position @ (force[:, :, None] @ network.motion)[:, :, 0]
    turned = (force[:, :, None] @ network.state.rotation[layout.position])[:, :, 0]
    by_target = -np.einsum("kvt,vta->kta", weighted, here.unit).reshape(k, -1)
    zeros = np.stack(
        [np.bincount(layout.zero.ravel(), w.ravel(), layout.n_zeros) for w in weighted]
    )
    kept = [by_target, (layout.by_place @ turned).reshape(k, -1), -zeros]
    lean = np.zeros((k, layout.size - 3 * n - 3 * len(layout.places) - layout.n_zeros))
    return PatternGradient(
        weighted, force, np.concatenate([*kept, lean, poses.reshape(k, -1)], axis=1)
    )


@dataclass(frozen=True, eq=False)
class Posterior:
    """``covariance`` (T, T) of all unknowns, T = K + 6 m: the kept ones, then the poses.

    ``arrived`` (V, 3): the scatter of each station, as its lengths determine it, m; ``leverage``
    (V, n): variance of each computed length, scatter included, m^2.
    """

    network: LengthNetwork
    covariance: Floats
    arrived: Floats
    leverage: Floats

    @property
    def targets(self) -> Floats:
        """The covariance (n, 3, n, 3) of the targets, m^2."""
        n = len(self.network.state.targets)
        return self.covariance[: 3 * n, : 3 * n].reshape(n, 3, n, 3)

    @property
    def poses(self) -> Floats:
        """The covariance (6 m, 6 m) of the poses."""
        k = self.network.layout.size
        return self.covariance[k:, k:]


def posterior(network: LengthNetwork) -> Posterior:
    """Return the covariances of a network at its minimum."""
    covariance = full_covariance(network)
    arrived, own, response = scattered(network)
    spread = response @ covariance  # (3 V, T)
    return Posterior(
        network, covariance, arrived, _leverage(network, covariance, own, response, spread)
    )


def full_covariance(network: LengthNetwork) -> Floats:
    """Return the covariance (T, T) of kept unknowns and poses, under the constraints."""
    kept = network.reduced.covariance()
    k, t = len(kept), len(kept) + network.reduced.inverse.shape[0] * 6
    whole = np.empty((t, t))
    whole[:k, :k] = kept
    whole[:k, k:] = -kept @ network.reduced.transfer
    whole[k:, :k] = whole[:k, k:].T
    whole[k:, k:] = -network.reduced.transfer.T @ whole[:k, k:]
    m = len(network.reduced.inverse)
    each = np.arange(m)
    whole[k:, k:].reshape(m, 6, m, 6)[each, :, each] += network.reduced.inverse
    return whole


def pulled(network: LengthNetwork) -> Floats:
    """Return U' W J (3 V, T): what unknowns do to the weighted errors along each station."""
    v, _, k = network.across.shape
    whole = np.zeros((v, 3, k + 6 * len(network.layout.angles)))
    whole[:, :, :k] = network.across
    _at_poses(network, whole, network.normal @ network.motion)
    return whole.reshape(3 * v, -1)


def _at_poses(network: LengthNetwork, whole: Floats, blocks: Floats) -> None:
    """Put ``blocks`` (V, 3, 6) where the poses of their stations are in ``whole`` (V, 3, T)."""
    each = np.arange(len(blocks))[:, None]
    columns = network.layout.size + 6 * network.layout.position[:, None] + np.arange(6)
    whole[each, :, columns] = blocks.swapaxes(1, 2)


def scattered(network: LengthNetwork) -> tuple[Floats, Floats, Floats]:
    """Return scatter (V, 3), its own covariance (V, 3, 3), and (3 V, T) how stations move.

    The scatter of a station follows its lengths, and so every unknown that these depend on.
    """
    layout, state, here = network.layout, network.state, network.slopes
    v, n, _ = here.unit.shape
    turned = state.rotation[layout.position]
    response = np.zeros((v, 3, layout.size + 6 * len(layout.angles)))
    columns = 3 * (n + layout.place)[:, None] + np.arange(3)
    response[np.arange(v)[:, None], :, columns] = turned.swapaxes(1, 2)
    _at_poses(network, response, network.motion)
    if network.scatter is None:
        return np.zeros((v, 3)), np.zeros((v, 3, 3)), response.reshape(3 * v, -1)
    root = network.scatter
    weighted = (here.unit * network.grid.weights[:, :, None]).swapaxes(1, 2)
    alone = weighted @ here.unit
    back = root.swapaxes(1, 2)
    own = root @ np.linalg.inv(np.eye(3) + back @ alone @ root) @ back
    gain = own @ weighted  # (V, 3, n)
    arrived = -(gain @ here.error[:, :, None])[:, :, 0]
    response -= own @ alone @ response
    response[:, :, : 3 * n] += (gain[:, :, :, None] * here.unit[:, None]).reshape(v, 3, 3 * n)
    station, zero, by_pair = layout.pairs
    first = 3 * (n + len(layout.places))
    response[station, :, first + zero] += by_pair @ gain.swapaxes(1, 2).reshape(v * n, 3)
    return arrived, own, response.reshape(3 * v, -1)


def _leverage(
    network: LengthNetwork, covariance: Floats, own: Floats, response: Floats, spread: Floats
) -> Floats:
    layout, unit = network.layout, network.slopes.unit
    v, n, _ = unit.shape
    each, targets = np.arange(v), np.arange(n)
    own = own + spread.reshape(v, 3, -1) @ response.reshape(v, 3, -1).swapaxes(1, 2)
    first = 3 * (n + len(layout.places))
    at_target = covariance[: 3 * n, : 3 * n].reshape(n, 3, n, 3)[targets, :, targets]
    at_zero = covariance[first + layout.zero, first + layout.zero]
    between = spread.reshape(v, 3, -1)[:, :, : 3 * n].reshape(v, 3, n, 3).transpose(0, 2, 1, 3)
    block = own[:, None] + at_target - between - between.swapaxes(2, 3)
    total = ((unit[:, :, None] @ block)[:, :, 0] * unit).sum(axis=2) + at_zero
    station = spread.reshape(v, 3, -1)[each[:, None], :, first + layout.zero]
    target = covariance[: 3 * n].reshape(n, 3, -1)[targets, :, first + layout.zero]
    return np.asarray(total - 2.0 * (unit * (station - target)).sum(axis=2), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class CurvePosterior:
    """The table's ``curves`` and their ``covariance`` (6 m, 6 m): d of all positions, then c.

    ``jacobian`` (6 m, 6 m): what steps of the poses do to them.
    """

    curves: Curves
    covariance: Floats
    jacobian: Floats


def curve_posterior(network: LengthNetwork, covariance: Floats) -> CurvePosterior:
    """Return the curves of a network and their covariance, from that of all unknowns (T, T)."""
    state, angles = network.state, network.layout.angles
    curves = table_curves(state.rotation, state.translation, angles)
    jacobian = curve_jacobian(curves, state.rotation, angles)
    k = network.layout.size
    return CurvePosterior(curves, jacobian @ covariance[k:, k:] @ jacobian.T, jacobian)
