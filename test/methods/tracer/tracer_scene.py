"""A simulated run with known truth: a table, a tracer on it, targets around it."""

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.tracer.solver import TracerProblem


@dataclass(frozen=True)
class Scene:
    angles: np.ndarray
    deviation: np.ndarray
    stations: np.ndarray
    targets: np.ndarray
    length: np.ndarray

    def problem(self, length_std=2e-7, target_std=0.0, **options):
        m, n = self.length.shape
        position, target = np.divmod(np.arange(m * n), n)
        rows = {
            "position": position,
            "target": target,
            "length": self.length.ravel(),
            "length_std": length_std,
            "targets": self.targets,
            "target_std": target_std,
            "table_angles": self.angles,
            "variant": "station",
            "error_motion_std": 0.0,
        }
        return TracerProblem(**{**rows, **options})


def arc(m, step_deg=30.0):
    return DEGREE * (-145.0 + step_deg * np.arange(m))


def paper_block(n, rng):
    """n targets in the paper's 450 x 600 x 450 mm above the table."""
    return rng.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))


def low_ring(n, rng):
    """n targets spread around the table, some above and some level: the angle's best friends."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False) + rng.normal(scale=0.1, size=n)
    radius, height = rng.uniform(0.3, 0.6, n), rng.uniform(0.0, 0.6, n)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def simulate(
    seed=0,
    angles=None,
    n=64,
    layout=paper_block,
    length_std=2e-7,
    target_std=0.0,
    error_motion=0.0,
):
    """Deviations of a few arcsec; errors drawn from the given standard deviations (m)."""
    rng = np.random.default_rng(seed)
    angles = arc(11) if angles is None else angles
    deviation = 5 * ARCSEC * (np.sin(angles) + 0.5 * np.cos(3 * angles))
    deviation -= deviation[0]
    actual = angles + deviation
    stations = np.column_stack([0.065 * np.cos(actual), 0.065 * np.sin(actual), 0 * actual + 0.12])
    stations[:, :2] += rng.normal(scale=1.0, size=(len(angles), 2)) * error_motion
    targets = layout(n, np.random.default_rng(99))
    true_targets = targets + rng.normal(scale=1.0, size=targets.shape) * target_std
    distance = np.linalg.norm(stations[:, None] - true_targets, axis=2)
    noise = rng.normal(scale=1.0, size=distance.shape) * length_std
    return Scene(angles, deviation, stations, targets, distance - distance[:, :1] + noise)
