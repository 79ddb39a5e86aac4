"""What gathers in one place: the lengths of a network as groups for the engine.

A disturbance often spoils several lengths at once: warm air or a person beside the machine makes
the beams of *one* station too long in one sector, something happens for a while. Groups are the
stations and the stretches of time, of which the engine says what gathers in them
(:mod:`rotcal_ros.adjust`), and the targets, whose chi-squared and rejected share are judged by the
same rules. What is proved is left out; what is only probable joins the covariance.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.gathering import SUSPECTED, Gathering, Words
from rotcal_ros.adjust.groups import Group, Undivided
from rotcal_ros.adjust.reliability import hidden
from rotcal_ros.adjust.subsets import neighbourhoods, runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.protection import POWER, Protection
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.solver.adjustment import Adjustment
from rotcal_ros.methods.tracer.solver.grid import FREE_TARGET_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.network import LengthView
from rotcal_ros.methods.tracer.solver_settings import TracerLimits

LEAST_OF_GROUP: Final = 4
"""Lengths that are a group."""
LARGEST: Final = 1e-4
"""Error (m) of several lengths that nobody would overlook."""
WORDS: Final = Words(
    "lengths", "warm air, a person or an obstacle", "in the beams", "in its beams"
)


def left_out(
    gathering: Gathering, grid: Grid, limits: TracerLimits
) -> tuple[Gathering, Bools, dict[int, str]] | None:
    """Return what is proved to be wrong together: (p, n) which lengths, and why by row.

    None where nothing is proved, or where too few lengths would be left.
    """
    case = gathering.proved(limits.rejection_significance)
    if case is None:
        return None
    rejected = np.zeros(grid.used.shape, dtype=np.bool_)
    rejected.flat[case.group.members[case.subset]] = True
    left = grid.used & ~rejected
    hit = np.unique(grid.station[rejected.any(axis=1)])
    if (grid.per_station(left)[hit] < grid.station_minimum + 1).any():
        return None
    if grid.free and (left.sum(axis=0)[rejected.any(axis=0)] < FREE_TARGET_MINIMUM).any():
        return None
    why = {
        int(grid.row[j, i]): f"station {grid.position_ids[grid.station[j]]}, target "
        f"{grid.target_ids[i]}: one of {int(case.subset.sum())} lengths of {case.group.name} that "
        f"are off together, by {WORDS.size(case.size)}"
        for j, i in np.argwhere(rejected)
    }
    return gathering.without(case), rejected, why


def protection(gathering: Gathering, std: Floats) -> tuple[Protection, ...]:
    """Return the statement about errors that gather; none where no group was judged.

    ``std`` (o,): standard uncertainties of the outputs.
    """
    judgement = gathering.judgement
    if judgement is None:
        return ()
    worst = hidden(judgement.groups, std, SUSPECTED, POWER, LARGEST, judgement.gathered)
    if worst is None:
        return ()
    what = "several lengths of one station that are too long together (warm air, a person)"
    size = f"{worst.size / MICROMETRE:.2g} um"
    return (engine.protection(worst, what, size, searched=" in every sector"),)


def groups_of(
    grid: Grid, fit: Adjustment, view: LengthView, residual: Floats, order: Ints
) -> tuple[Group | Undivided, ...]:
    """Return the groups of a network, by the ``view`` at it and its ``residual`` (p, n), m.

    ``order`` (k,): when each row of the problem was taken. What lies together in no way is judged
    as a whole only.
    """
    found: list[Group | Undivided] = []
    for places in places_of(grid, fit, order):
        strip, target = places.at.T
        unit = 1.0 / grid.length_std[strip, target]
        white = residual[strip, target] * unit
        if not len(places.gathered):
            cofactor = view.cofactor(strip, target, unit)
            found.append(Undivided(places.kind, places.name, white, cofactor, places.lost))
            continue
        leverage, sensitivity = view.leverage(strip, target), view.sensitivity(strip, target)
        number = np.ravel_multi_index((strip, target), grid.used.shape)
        found.append(
            Group.of(
                places.kind, places.name, number, white[:, None], unit[:, None],
                leverage * unit * unit[:, None], sensitivity.weighted(unit), places.gathered,
                places.lost,
            )
        )  # fmt: skip
    return tuple(found)


class Places(NamedTuple):
    """The places ``at`` (e, 2) of the grid that are a group, and how many were rejected of it."""

    kind: str
    name: str
    at: Ints
    gathered: Bools
    lost: int


def places_of(grid: Grid, fit: Adjustment, order: Ints) -> list[Places]:
    """Return what belongs to each station, target and stretch of time."""
    known = grid.row >= 0
    found = []
    strips = np.argsort(grid.station, kind="stable")
    ends = np.cumsum(np.bincount(grid.station, minlength=grid.n_stations))
    missing = (known & ~grid.used).sum(axis=1)
    for j, mine in enumerate(np.split(strips, ends[:-1])):
        name = grid.position_ids[j]
        strip, target = np.nonzero(grid.used[mine])
        at = np.column_stack([mine[strip], target])
        beams = fit.targets[target] - fit.stations[j]
        lost = int(missing[mine].sum())
        found.append(Places("station", f"station {name}", at, _sectors(beams), lost))
    for i, name in enumerate(grid.target_ids.tolist()):
        strip = np.flatnonzero(grid.used[:, i])
        at = np.column_stack([strip, np.full(len(strip), i)])
        lost = int((known & ~grid.used)[:, i].sum())
        found.append(Places("target", f"target {name}", at, _none(len(at)), lost))
    found += _stretches(grid, order)
    return [places for places in found if len(places.at) >= LEAST_OF_GROUP]


def _none(size: int) -> Bools:
    return np.zeros((0, size), dtype=np.bool_)


def _sectors(beams: Floats) -> Bools:
    """Return which beams (e, 3) of one station lie together, round it and all about."""
    if len(beams) < LEAST_OF_GROUP:
        return _none(len(beams))
    round_ = np.arctan2(beams[:, 1], beams[:, 0])
    unit = beams / np.linalg.norm(beams, axis=1)[:, None]
    return np.concatenate([runs(round_, closed=True), neighbourhoods(unit)])


def _stretches(grid: Grid, order: Ints) -> list[Places]:
    """Return stretches of time as long as a station's lengths; none where they are the stations.

    What gathers in them lasts for a while.
    """
    strip, target = np.nonzero(grid.row >= 0)
    rank = np.argsort(order[grid.row[strip, target]], kind="stable")
    strip, target = strip[rank], target[rank]
    arrivals = 1 + int((np.diff(grid.station[strip]) != 0).sum())
    if arrivals <= grid.n_stations:
        return []
    size = max(len(strip) // grid.n_stations, 2 * LEAST_OF_GROUP)
    found = []
    for first in range(0, len(strip) - LEAST_OF_GROUP + 1, size):
        at = np.column_stack([strip, target])[first : first + size]
        kept = at[grid.used[at[:, 0], at[:, 1]]]
        name = f"the stretch from length {first} to {first + len(at) - 1} in time"
        gathered = runs(np.arange(len(kept), dtype=np.float64))
        found.append(Places("stretch", name, kept, gathered, len(at) - len(kept)))
    return found
