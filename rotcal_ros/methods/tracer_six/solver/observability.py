"""What the lengths cannot tell: which pose is open, and in which direction."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.tracer.solver.observability import or_prior
from rotcal_ros.methods.tracer_six.solver.network import LengthNetwork
from rotcal_ros.methods.tracer_six.solver.posterior import CurvePosterior

RANK_TOLERANCE: Final = 1e-13
CURE: Final = (
    "measure more targets, spread low around the table, from places 120 degrees apart, or keep "
    "the beam unbroken (fewer zeros)"
)
NAMES: Final = ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC")


def check_determined(network: LengthNetwork) -> None:
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
        factor, unit = unit_of(NAMES[3 * kind + axis])
        raise ObservabilityError(
            f"{NAMES[3 * kind + axis]} at position {position} is known to "
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
