"""Errors of the lengths that follow a pattern, as a network feels them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer_six.solver.network import LengthNetwork


@dataclass(frozen=True, eq=False)
class PatternGradient:
    """Patterns (k, V, n), m, in a network: ``weighted`` (k, V, n) by the inverse covariance.

    ``force`` (k, V, 3): their pull at each station; ``slope`` (k, T): at all unknowns, half the
    slope of chi-squared.
    """

    weighted: Floats
    force: Floats
    slope: Floats


def pattern_gradient(network: LengthNetwork, patterns: Floats) -> PatternGradient:
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
