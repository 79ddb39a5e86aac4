"""Geometries for plans of a tracer, and dense algebra to hold what is planned against."""

from itertools import product

import numpy as np

from rotcal_ros.geometry.rotations import on_table
from rotcal_ros.methods.tracer.policy.information import Lengths, Scene

ANGLES = np.radians(-145.0 + 30.0 * np.arange(11))
STATIONS = on_table((0.0569, -0.0318, 0.1225), ANGLES, (1e-4, -2e-4))
BLOCK = np.array(
    list(product(*(np.linspace(*ends, 4) for ends in [(-0.225, 0.225), (-0.3, 0.3), (1.2, 1.65)])))
)
"""The 64 targets of the paper's experiment, m."""
PER_AXIS = np.tile([1e-6, 2e-6, 0.5e-6], (64, 1))


def every_pair(scene, segment="station"):
    """All pairs, with a zero per station or one for all."""
    position, target = (
        axis.ravel() for axis in np.indices((len(scene.stations), len(scene.targets)))
    )
    return Lengths.of(position, target, position if segment == "station" else 0)


def dense_covariance(scene, lengths, segments):
    """Covariance of [stations, zeros, targets] by one dense inverse; column-scaled lstsq."""
    m, n = len(scene.stations), len(scene.targets)
    rows = np.zeros((len(lengths), 3 * m + segments + 3 * n))
    for k, (j, i, s, w) in enumerate(
        zip(lengths.position, lengths.target, lengths.segment, lengths.weight, strict=True)
    ):
        apart = scene.stations[j] - scene.targets[i]
        distance = np.linalg.norm(apart)
        std = np.hypot(scene.length_std, scene.length_std_relative * distance)
        place = 3 * m + segments + 3 * i
        rows[k, 3 * j : 3 * j + 3] = apart / distance
        rows[k, 3 * m + s] = -1.0
        rows[k, place : place + 3] = -apart / distance
        rows[k] *= np.sqrt(w) / std
    prior = np.zeros((3 * n, rows.shape[1]))
    prior[:, 3 * m + segments :] = np.diag(1.0 / scene.target_std.ravel())
    upper = np.linalg.qr(np.vstack([rows, prior]), mode="r")
    inverse = np.linalg.inv(upper)
    return inverse @ inverse.T, rows


def zero_mean(scene):
    """Jacobian (m, 3 m) of the angles less their mean."""
    return scene.bearing - scene.bearing.mean(axis=0)


def paper_scene(**changes):
    values = {"targets": BLOCK, "target_std": 1e-6, "length_std": 0.2e-6, **changes}
    return Scene(stations=STATIONS, table_angles=ANGLES, **values)


def counted_from_first(known):
    """Covariance (m, m) of ECC as a result counts it, from the first angle, with error motion."""
    whole = known.angle_covariance + known.scene.error_motion_angles
    from_first = np.eye(len(whole))
    from_first[:, 0] -= 1.0
    return from_first @ whole @ from_first.T


def some_plan():
    """The paper's scene with a moving axis, all its pairs, and 14 lengths of each station."""
    scene = paper_scene(target_std=[1e-6, 2e-6, 0.5e-6], error_motion_std=5e-8)
    pairs = every_pair(scene)
    rng = np.random.default_rng(3)
    chosen = np.concatenate(
        [rng.choice(np.flatnonzero(pairs.position == j), 14, replace=False) for j in range(11)]
    )
    return scene, pairs, chosen
