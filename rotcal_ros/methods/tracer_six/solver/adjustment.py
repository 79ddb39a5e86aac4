"""The rigid table's network of lengths as an adjustment, from its start values to its checks.

The tracer's screening and noise estimate work on it as on any other adjustment. Stations are the
arrivals of the table at a position in one run; their scatter from arrival to arrival is adjusted
beside the unknowns.

Start values: stations by multilateration, then poses by rigid fits. Targets in one plane leave two
images of each station; the nominal places tell which is meant. A position without three of its
stations starts at its commanded angle.

Jumps of a zero are searched for as with a single place (:mod:`~..tracer.solver.zeros`). Lengths
of a run that grow by the same amount from some moment on look like a place that rose there, and
three places always have a plane: where no angle is measured again in the same run, most of a slip
is taken for tilts and heights of the table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, unit_of
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import align, rotation_about_z
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment
from rotcal_ros.methods.tracer.solver.gathering import group_at, places_of
from rotcal_ros.methods.tracer.solver.grid import STATION_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.joint import redundancy_of_targets, target_test
from rotcal_ros.methods.tracer.solver.observability import or_prior
from rotcal_ros.methods.tracer.solver.start import start_candidates
from rotcal_ros.methods.tracer.solver.zeros import (
    Jump,
    ShiftResponse,
    Shifts,
    TimedLengths,
    find_jump,
    shifts_felt,
)
from rotcal_ros.methods.tracer_six.solver.layout import (
    StationLayout,
    lost_direction,
)
from rotcal_ros.methods.tracer_six.solver.network import (
    CurvePosterior,
    LengthNetwork,
    NetworkState,
    Posterior,
    curve_posterior,
    pattern_gradient,
    posterior,
    relax,
    scattered,
)
from rotcal_ros.methods.tracer_six.solver.scatter import (
    Scatter,
    contrasts,
    estimate,
    stated,
)

RANK_TOLERANCE: Final = 1e-13
"""Eigenvalue, as a share of the largest, of a direction that the lengths leave open."""
CURE: Final = (
    "measure more targets, spread low around the table, from places 120 degrees apart, or keep "
    "the beam unbroken (fewer zeros)"
)
NEAR: Final = 0.05
"""Distance (m) from its nominal place beyond which a multilaterated station is not believed."""
ROUNDS: Final = 2
"""Poses from places, then places from poses: each round takes nearly all that nominals lack."""
NONE: Final = stated(0.0, 0.0)
"""Of a table that repeats."""


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

    layout: StationLayout
    state: NetworkState
    stated: tuple[float | None, float | None]
    significance: float

    def __call__(
        self, grid: Grid, start: Floats, targets: Floats | None = None
    ) -> RigidAdjustment:
        """Return the adjustment of ``grid``; it starts from its own state, whatever is given."""
        network, scatter = _solve_network(
            grid, self.layout, self.state, self.stated, self.significance
        )
        return _adjustment(network, scatter)


def _solve_network(
    grid: Grid,
    layout: StationLayout,
    state: NetworkState,
    known: tuple[float | None, float | None],
    significance: float,
) -> tuple[LengthNetwork, Scatter]:
    """Return the network at its minimum with the scatter that it tells, or that is ``known``."""
    network = relax(grid, layout, None, state)
    _check_determined(network)
    arms = network.state.arms(layout)
    scatter = estimate(contrasts(network, arms), *known, significance)
    roots = scatter.roots(arms)
    if roots is not None:
        network = relax(grid, layout, roots, network.state)
    return network, scatter


def _adjustment(network: LengthNetwork, scatter: Scatter) -> RigidAdjustment:
    grid, layout, state = network.grid, network.layout, network.state
    after = posterior(network)
    felt = (network.slopes.unit @ after.arrived[:, :, None])[:, :, 0]
    corrections, redundancy, coupling = _felt_by_targets(grid, state, after)
    unknowns = layout.size + 6 * len(layout.angles)
    rank = unknowns - network.reduced.constraints.shape[1]
    extra = 0 if grid.free else state.targets.size
    extra += 0 if layout.tilt_std is None else 2 * len(layout.angles)
    return RigidAdjustment(
        stations=state.stations(layout) + after.arrived,
        distances=state.zeros[layout.zero[:, 0]],
        targets=state.targets,
        residual=-(network.slopes.error + felt),
        std=grid.length_std,
        redundancy=grid.used - grid.weights * after.leverage,
        chi2=network.slopes.chi2,
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


def _felt_by_targets(
    grid: Grid, state: NetworkState, after: Posterior
) -> tuple[Floats, Floats, Floats]:
    """Return corrections (n, 3), redundancy (n, 3, 3), coupling (3, 3) as Adjustment has them."""
    n = len(grid.targets)
    if grid.free:
        return np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((3, 3))
    std = grid.target_std
    whole, each = redundancy_of_targets(after.targets, std), np.arange(n)
    coupling = np.einsum("iajb,iajb->ab", whole, whole)
    return (state.targets - grid.targets) / std, whole[each, :, each], coupling


def _check_determined(network: LengthNetwork) -> None:
    """Raise ObservabilityError where more stays open than is known in advance."""
    values, vectors = np.linalg.eigh(network.reduced.regular())
    missing = int((values < RANK_TOLERANCE * values[-1]).sum())
    if missing:
        raise ObservabilityError(
            f"the lengths leave {missing} more direction(s) open than expected; the weakest moves "
            f"most {_unknown(network, network.reduced.scale * vectors[:, 0])}: {CURE}"
            f"{or_prior(free=network.layout.grid.free)}"
        )


def check_curves(table: CurvePosterior, places: Floats, limit: float) -> None:
    """Raise ObservabilityError where a curve is known worse than ``limit`` of the radius.

    ``places`` (p, 3): of the tracer on the table, m.
    """
    m = len(table.curves.rotation)
    std = np.sqrt(np.maximum(table.covariance.diagonal(), 0.0)).reshape(2, m, 3)
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    share = std / np.array([radius, 1.0])[:, None, None]
    kind, position, axis = np.unravel_index(np.argmax(share), share.shape)
    if share[kind, position, axis] > limit:
        factor, unit = unit_of(COMPONENTS[3 * kind + axis])
        raise ObservabilityError(
            f"{COMPONENTS[3 * kind + axis]} at position {position} is known to "
            f"{std[kind, position, axis] / factor:.2g} {unit} only (standard deviation): {CURE}"
        )


def _unknown(network: LengthNetwork, direction: Floats) -> str:
    layout = network.layout
    index = int(np.argmax(np.abs(direction)))
    n, p = len(network.state.targets), len(network.state.places)
    if index < 3 * n:
        return f"target {layout.grid.target_ids[index // 3]} along {'xyz'[index % 3]}"
    if index < 3 * (n + p):
        place = layout.place_ids[index // 3 - n]
        return f"the tracer's place {place} along {'xyz'[index % 3]}"
    if index < 3 * (n + p) + layout.n_zeros:
        return "a zero of the lengths"
    return "the tilt of the table in the machine"


def find_start(layout: StationLayout) -> NetworkState:
    """Return start values for ``layout``; raises DataError when places and lengths contradict."""
    grid = layout.grid
    about = rotation_about_z(layout.angles)
    nominal = (about[layout.position] @ layout.places[layout.place][:, :, None])[:, :, 0]
    most = layout.most
    found = start_candidates(grid.targets, grid.length, most)[:, :, :3]
    away = np.linalg.norm(found - nominal, axis=2)
    best = np.argmin(away, axis=0)
    each = np.arange(len(best))
    near = away[best, each] < NEAR
    _check_near(layout, near | (most.sum(axis=1) < STATION_MINIMUM), away[best, each])
    stations = np.where(near[:, None], found[best, each], nominal)
    rotation, translation, places = about, np.zeros((len(about), 3)), layout.places
    for _ in range(ROUNDS):
        rotation, translation = _poses(layout, stations, near, places, about)
        back = (stations - translation[layout.position])[:, None] @ rotation[layout.position]
        # a place whose stations are all lost keeps its nominal one, which they then stand at
        weight = layout.by_place * np.where(near, 1.0, 1e-9)
        places = (weight / weight.sum(axis=1, keepdims=True)) @ back[:, 0]
    tilts = np.zeros(0 if layout.tilt_std is None else 4)
    state = NetworkState(
        rotation, translation, places, np.zeros(layout.n_zeros), grid.targets.copy(), tilts
    )
    distance = np.linalg.norm(state.stations(layout)[:, None] - grid.targets, axis=2)
    apart = np.where(grid.used, distance - grid.length, 0.0)
    total = np.bincount(layout.zero.ravel(), apart.ravel(), minlength=layout.n_zeros)
    count = np.bincount(layout.zero.ravel(), grid.used.ravel(), minlength=layout.n_zeros)
    state.zeros[:] = total / np.maximum(count, 1)
    return state


def _poses(
    layout: StationLayout, stations: Floats, near: Bools, places: Floats, about: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (m, 3, 3) and translations (m, 3) that take ``places`` to ``stations``."""
    rotation, translation = about.copy(), np.zeros((len(about), 3))
    for i in range(len(about)):
        here = np.flatnonzero((layout.position == i) & near)
        own = places[layout.place[here]]
        if lost_direction(own) is None:
            rotation[i], translation[i] = align(own, stations[here])
    return rotation, translation


def _check_near(layout: StationLayout, near: Bools, away: Floats) -> None:
    if np.mean(near) > 0.5:
        return
    worst = int(np.argmax(away))
    raise DataError(
        f"{layout.station_name(worst)}: the lengths put the tracer {away[worst]:.3g} m from its "
        f"nominal place, and {np.count_nonzero(~near)} of {len(near)} stations are farther than "
        f"{NEAR:g} m: check the places, the numbering of the positions, the sense of the table "
        "angles, and whether the targets are in the frame of the machine with z along the axis"
    )


def groups_of(grid: Grid, fit: RigidAdjustment, order: Ints) -> tuple[Group, ...]:
    """Return the groups of a network; outputs are its curves (6 m,): d of all positions, then c.

    ``order`` (k,): when each row of the problem was taken.
    """
    network, covariance = fit.posterior.network, fit.posterior.covariance
    layout, unit = network.layout, network.slopes.unit
    outputs = np.zeros((6 * len(layout.angles), len(covariance)))
    outputs[:, layout.size :] = curve_posterior(network, covariance).jacobian
    carried = outputs @ covariance
    _, own, response = scattered(network)
    moved = response.reshape(len(unit), 3, -1)
    first_zero = 3 * (unit.shape[1] + len(layout.places))
    found = []
    for places in places_of(grid, fit, order):
        station, target = places.at.T
        each, towards = np.arange(len(station)), unit[station, target]
        design = (towards[:, None] @ moved[station])[:, 0]
        design[each[:, None], 3 * target[:, None] + np.arange(3)] -= towards
        design[each, first_zero + layout.zero[station, target]] -= 1.0
        beside = (towards[:, None] @ own[station])[:, 0] @ towards.T
        beside *= station[:, None] == station
        sensitivity = Sensitivity.whole(carried @ design.T)
        found.append(
            group_at(
                grid, places, fit.residual, design @ covariance @ design.T + beside, sensitivity
            )
        )
    return tuple(found)


def find_shifts(fit: RigidAdjustment, order: Ints) -> Shifts:
    """Return shifts of the zeros at some moments, and what they do to the curves (t, 6 m).

    ``order`` (k,): when each row of the problem was taken.
    """
    network = fit.posterior.network
    moments = TimedLengths.of(network.grid, order, network.layout.zero)
    jacobian = curve_posterior(network, fit.posterior.covariance).jacobian
    return shifts_at(fit, jacobian, moments, moments.few())


def shifts_at(fit: RigidAdjustment, jacobian: Floats, moments: TimedLengths, at: Ints) -> Shifts:
    """Return the shifts that begin ``at`` (t,) some of the ``moments``."""
    after = fit.posterior

    def respond(later: Bools) -> ShiftResponse:
        longer = later.astype(np.float64)
        here = pattern_gradient(after.network, longer)
        step = here.slope @ after.covariance
        both = (here.weighted[1:] * longer[:-1]).sum(axis=(1, 2))
        both -= (step[1:] * here.slope[:-1]).sum(axis=1)
        return ShiftResponse(
            total=(here.weighted * longer).sum(axis=(1, 2)),
            taken=(step * here.slope).sum(axis=1),
            both=both,
            moved=step[:, after.network.layout.size :] @ jacobian.T,
        )

    return shifts_felt(after.network.grid, fit, moments, at, respond, len(jacobian), overlap=1)


def find_broken_zero(fit: RigidAdjustment, shifts: Shifts, significance: float) -> Jump | None:
    """Return the jump of a zero that stands out most, None if none does.

    ``significance``: of the largest at any moment. The jump's segment is the zero that broke.
    """

    def near(at: Ints) -> Shifts:
        return shifts_at(
            fit, np.zeros((0, 6 * len(fit.posterior.network.layout.angles))), shifts.moments, at
        )

    return find_jump(fit.posterior.network.grid, fit, shifts, significance, at=near)


def split(
    layout: StationLayout, state: NetworkState, grid: Grid, jump: Jump, order: Ints
) -> tuple[StationLayout, NetworkState]:
    """Return ``layout`` and ``state`` with a new zero from ``jump`` on."""
    filled = grid.row >= 0
    time = np.where(filled, order[grid.row], order.max())
    time = np.where(filled, time, time.min(axis=1, keepdims=True))
    later = (layout.zero == jump.segment) & (time >= order[jump.row])
    return replace(
        layout,
        zero=np.where(later, layout.n_zeros, layout.zero),
        offset=np.append(layout.offset, layout.offset[jump.segment]),
    ), replace(state, zeros=np.append(state.zeros, state.zeros[jump.segment]))
