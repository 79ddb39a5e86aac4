"""Stations, reflectors and hours: what a plane-mirror calibration takes, by its own solver."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Final

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.calibration import Calibration, prepare
from rotcal_ros.methods.configuration import Configuration, changed
from rotcal_ros.methods.goal import expanded_about_mean

USUAL: Final = """
/**:
  ros__parameters:
    method: plane_mirror
    plan:
      table_step_deg: 22.5
      table_positions: 17
      shared_positions: 1
      nests_m: [1.53, 0.47, 0.1, 0.39, 1.73, 0.55, -1.37, 1.35, 1.0,
                -2.02, -0.62, 0.1, -0.35, -1.56, 0.55, 1.26, -1.24, 1.0]
    solver: {way: joint}
"""
"""A whole turn with closure, six nests around the table, and the solver's usual noise."""


@dataclass(frozen=True)
class MirrorTrade:
    """A plan of ``stations`` with ``reflectors`` at each position.

    ``pairs`` (direct and mirrored) and ``nests`` are measured in ``seconds``, the moves of the
    tracker included. ``expanded``: U (k = 2) of ECC, rms over the angles about their mean, rad.
    """

    stations: int
    reflectors: int
    pairs: int
    nests: int
    seconds: float
    expanded: float


def mirror_trade(
    configuration: Configuration,
    stations: Sequence[int],
    reflectors: Sequence[int],
    *,
    move_s: float,
    pair_s: float,
    nest_s: float,
) -> tuple[MirrorTrade, ...]:
    """Return the plans with so many stations and reflectors, the quickest first.

    The covariance is the solver's, for exact points of the configuration's plan. Numbers of
    stations that see the mirror beyond the limit of incidence, or that no share of the positions
    gives, are left out. Raises PlanError when none is left.
    """
    plans = _plans(configuration, stations, reflectors)
    rows = [_measured(calibration, move_s, pair_s, nest_s) for calibration in plans]
    if not rows:
        raise PlanError(
            f"{configuration.source}: none of {list(stations)} tracker stations can share the "
            "table positions within the limit of incidence: allow more of them"
        )
    return tuple(sorted(rows, key=lambda row: row.seconds))


def _plans(
    configuration: Configuration, stations: Sequence[int], reflectors: Sequence[int]
) -> Iterator[Calibration]:
    """Yield the plans that are possible."""
    positions, shared = configuration.plan.table_positions, configuration.plan.shared_positions
    for count in stations:
        own = ceil((positions - shared) / count)
        if ceil((positions - shared) / own) != count:
            continue
        for number in reflectors:
            changes = [
                f"plan.positions_per_station={own + shared}", f"plan.reflectors={number}"
            ]  # fmt: skip
            try:
                calibration = prepare(changed(configuration, changes))
            except PlanError:
                break
            yield calibration.of_distances


def _measured(
    calibration: Calibration, move_s: float, pair_s: float, nest_s: float
) -> MirrorTrade:
    steps = calibration.plan.steps
    covariance = calibration.solve(calibration.nominal_observations()).covariance["ECC"]
    stations = len({step.station for step in steps})
    pairs = sum(step.kind == PointKind.MIRRORED for step in steps)
    nests = len(steps) - 2 * pairs
    return MirrorTrade(
        stations=stations,
        reflectors=calibration.configuration.plan.reflectors,
        pairs=pairs,
        nests=nests,
        seconds=stations * move_s + pairs * pair_s + nests * nest_s,
        expanded=expanded_about_mean(covariance),
    )
