"""How far the targets of each station are from lying in a plane.

A tracer and its mirror image in the plane of its targets are equally far from all of them: no
length tells the one from the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.design.scene import Lengths, Scene

LEAST_DEPTH: Final = 0.1
"""Of the targets of a station, across the plane they lie nearest to, over their extent."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Targets by station: ``count`` (m,), ``total`` (m, 3) in m and ``products`` (m, 3, 3)."""

    count: Floats
    total: Floats
    products: Floats

    @classmethod
    def of(cls, scene: Scene, lengths: Lengths) -> Spread:
        """Return the targets that each station of ``scene`` sees with the ``lengths``."""
        targets = _centred(scene)[lengths.target]
        at = (lengths.position == np.arange(len(scene.stations))[:, None]).astype(np.float64)
        products = (at[:, :, None] * targets).swapaxes(1, 2) @ targets
        return cls(at.sum(axis=1), at @ targets, products)

    @property
    def depth(self) -> Floats:
        """Depth (m,) at each station, 0 to 1; 0 of targets in a plane."""
        return _depth(self.count, self.total, self.products)

    def depth_after(self, scene: Scene, lengths: Lengths, sign: float) -> Floats:
        """Return the depth (k,) at its station after each of k changes by itself.

        ``sign``: 1 where one of the ``lengths`` comes, -1 where one goes.
        """
        targets, at = _centred(scene)[lengths.target], lengths.position
        squares = targets[:, :, None] * targets[:, None]
        return _depth(
            self.count[at] + sign,
            self.total[at] + sign * targets,
            self.products[at] + sign * squares,
        )


def least_depth(scene: Scene, lengths: Lengths) -> float:
    """Return the smallest depth of the targets of any station."""
    return float(Spread.of(scene, lengths).depth.min())


def flat_stations(scene: Scene, lengths: Lengths, least: float = LEAST_DEPTH) -> Ints:
    """Return the stations whose targets are less than ``least`` deep."""
    return np.flatnonzero(Spread.of(scene, lengths).depth < least)


def _centred(scene: Scene) -> Floats:
    return np.asarray(scene.targets - scene.targets.mean(axis=0), dtype=np.float64)


def _depth(count: Floats, total: Floats, products: Floats) -> Floats:
    mean = total / np.maximum(count, 1.0)[:, None]  # a station may have none
    values = np.linalg.eigvalsh(products - total[:, :, None] * mean[:, None])
    tiny = np.finfo(np.float64).tiny
    shares = np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 2], tiny)
    return np.asarray(np.sqrt(shares), dtype=np.float64)
