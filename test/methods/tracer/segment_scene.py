"""Lengths of stations that share zeros, and their adjustment dense, column by column."""

from dataclasses import dataclass

import numpy as np
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.solver import TracerProblem

LENGTH_STD, TARGET_STD = 2e-7, 1e-6


@dataclass(frozen=True)
class Lengths:
    """Rows of one run: all stations at each target, or all targets at each station."""

    angles: np.ndarray
    deviation: np.ndarray
    stations: np.ndarray
    targets: np.ndarray
    position: np.ndarray
    target: np.ndarray
    distance: np.ndarray
    noise: np.ndarray
    order: np.ndarray

    def problem(self, zero, segment, **options):
        """``zero`` (k,) in m and ``segment`` (k,) in the order of measuring."""
        length = self.distance + self.noise
        length[self.order.argsort()] -= np.broadcast_to(zero, len(length))
        if segment is not None:
            segment = np.broadcast_to(segment, len(length))[self.order]
        rows = {
            "position": self.position,
            "target": self.target,
            "length": length,
            "length_std": LENGTH_STD,
            "targets": self.targets,
            "target_std": TARGET_STD,
            "table_angles": self.angles,
            "order": self.order,
            "segment": segment,
            "error_motion_std": 0.0,
        }
        return TracerProblem(**{**rows, **options})


def measure(seed=0, m=7, n=20, kept=None, by_target=True, layout=low_ring):
    """``kept``: this many lengths at each station, to targets of its own choice."""
    rng = np.random.default_rng(1000 + seed)
    scene = simulate(seed, arc(m, 45.0), n, layout)
    position, target = np.divmod(np.arange(m * n), n)
    if kept is not None:
        places = np.concatenate([n * j + np.sort(rng.permutation(n)[:kept]) for j in range(m)])
        position, target = position[places], target[places]
    true_targets = scene.targets + TARGET_STD * rng.standard_normal(scene.targets.shape)
    distance = np.linalg.norm(scene.stations[position] - true_targets[target], axis=1)
    keys = (position, target) if by_target else (target, position)
    order = np.lexsort(keys).argsort()
    noise = LENGTH_STD * rng.standard_normal(len(distance))
    return Lengths(
        scene.angles, scene.deviation, scene.stations, scene.targets, position, target, distance,
        noise, order,
    )  # fmt: skip
