"""Geometries for plans of a tracer, and dense algebra to hold what is planned against."""

from itertools import product

import numpy as np

from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.policy.information import Lengths, Scene

ANGLES = np.radians(-145.0 + 30.0 * np.arange(11))
STATIONS = positions_on_table((0.0569, -0.0318, 0.1225), ANGLES, (1e-4, -2e-4))
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


def circle(scene):
    """Unit vectors (m, 2) out from the axis and along the circle, and its radius, m."""
    flat = scene.stations[:, :2]
    design = np.column_stack([2.0 * flat, np.ones(len(flat))])
    outward = flat - np.linalg.lstsq(design, (flat**2).sum(axis=1))[0][:2]
    radius = np.linalg.norm(outward, axis=1).mean()
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return outward, np.column_stack([-outward[:, 1], outward[:, 0]]), radius


def dense_covariance(scene, lengths, segments):
    """Covariance of [stations, zeros, targets, centre, radius] by one dense inverse.

    The stations lie on a circle but for the error motion, or for 1 nm.
    """
    m, n = len(scene.stations), len(scene.targets)
    own = 3 * m + segments + 3 * n
    rows = np.zeros((len(lengths), own + 3))
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
    prior = np.zeros((3 * n, own + 3))
    prior[:, 3 * m + segments : own] = np.diag(1.0 / scene.target_std.ravel())
    outward, _, _ = circle(scene)
    round_ = np.zeros((m, own + 3))
    for j in range(m):
        round_[j, 3 * j : 3 * j + 2] = outward[j]
    round_[:, own:] = -np.column_stack([outward, np.ones(m)])
    round_ /= max(scene.error_motion_std or 0.0, 1e-9)
    upper = np.linalg.qr(np.vstack([rows, prior, round_]), mode="r")
    inverse = np.linalg.inv(upper)
    return inverse @ inverse.T, rows


def to_angles(scene, unknowns):
    """Jacobian (m, p) of the angles less their mean by what :func:`dense_covariance` has."""
    _, along, radius = circle(scene)
    turn = np.zeros((len(along), unknowns))
    for j, unit in enumerate(along):
        turn[j, 3 * j : 3 * j + 2] = unit / radius
    turn[:, -3:-1] = -along / radius
    return turn - turn.mean(axis=0)


def dense_angles(scene, lengths, segments):
    """Covariance (m, m) of the angles less their mean, with what moves along the circle."""
    whole, _ = dense_covariance(scene, lengths, segments)
    turn = to_angles(scene, len(whole))
    motion = max(scene.error_motion_std or 0.0, 1e-9) / circle(scene)[2]
    return turn @ whole @ turn.T + motion**2 * (np.eye(len(turn)) - 1.0 / len(turn))


def zero_mean(scene):
    """Jacobian (m, 3 m) of the angles less their mean by stations that are known exactly."""
    outward, along, radius = circle(scene)
    m = len(along)
    centre = np.linalg.pinv(np.column_stack([outward, np.ones(m)]))[:2]
    turn = np.zeros((m, m, 3))
    turn[:, :, :2] = -((along / radius) @ centre)[:, :, None] * outward
    turn[np.arange(m), np.arange(m), :2] += along / radius
    turn = turn.reshape(m, 3 * m)
    return turn - turn.mean(axis=0)


def paper_scene(**changes):
    values = {"targets": BLOCK, "target_std": 1e-6, "length_std": 0.2e-6, **changes}
    return Scene(stations=STATIONS, table_angles=ANGLES, **values)


def counted_from_first(known):
    """Covariance (m, m) of ECC as a result counts it, from the first angle."""
    from_first = np.eye(len(known.covariance))
    from_first[:, 0] -= 1.0
    return from_first @ known.covariance @ from_first.T


def some_plan():
    """The paper's scene with a moving axis, all its pairs, and 14 lengths of each station."""
    scene = paper_scene(target_std=[1e-6, 2e-6, 0.5e-6], error_motion_std=5e-8)
    pairs = every_pair(scene)
    rng = np.random.default_rng(3)
    chosen = np.concatenate(
        [rng.choice(np.flatnonzero(pairs.position == j), 14, replace=False) for j in range(11)]
    )
    return scene, pairs, chosen
