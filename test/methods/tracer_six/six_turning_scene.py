"""A table that turns under a tracer at three places, in the time domain; no code of the solver."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

DEGREE, ARCSEC, RATE_HZ = np.pi / 180.0, np.pi / 648000.0, 1000.0
NAMES = ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC")


@dataclass(frozen=True)
class SixTurningScene:
    """Lengths at angles that the table passes, and what is true of its six deviations.

    ``angle``, ``run``, ``place``, ``target`` (k,), ``speed`` (rad/s), ``length`` (m), ``turn``
    (k,); ``true`` (6, r, n): of each run, m and rad. ``readings``: time (s), angle of the feedback
    (deg) and length (m) of each turn, in their order.
    """

    angle: np.ndarray
    run: np.ndarray
    place: np.ndarray
    target: np.ndarray
    speed: np.ndarray
    length: np.ndarray
    turn: np.ndarray
    angles: np.ndarray
    true: np.ndarray
    nominal: np.ndarray
    places: np.ndarray
    readings: list[np.ndarray]


def turned(x, y, z, vectors):
    """Vectors (k, 3) turned about x, then y, then z by angles (k,)."""
    for first, second, by in ((1, 2, x), (2, 0, y), (0, 1, z)):
        a, b = vectors[:, first].copy(), vectors[:, second].copy()
        vectors[:, first] = np.cos(by) * a - np.sin(by) * b
        vectors[:, second] = np.sin(by) * a + np.cos(by) * b
    return vectors


def six_turning_scene(
    seed, *, angles=24, targets=4, noise=0.2e-6, correlated_s=0.0, lag=1e-3, speed_deg_s=12.0,
    window_deg=0.5,
):  # fmt: skip
    """Turn a table forward and back for each target from each place; lengths by a cubic."""
    rng = np.random.default_rng(seed)
    around = 2.0 * np.pi * np.arange(targets) / targets + 0.3
    heights = np.where(np.arange(targets) % 2, 0.3, 0.7)
    nominal = np.column_stack([0.5 * np.cos(around), 0.5 * np.sin(around), heights])
    true = nominal + rng.normal(0.0, 1e-6, nominal.shape)
    at = 2.0 * np.pi * np.arange(3) / 3.0
    places = np.column_stack([0.15 * np.cos(at), 0.15 * np.sin(at), np.full(3, 0.12)])
    stood = places + rng.normal(0.0, 3e-4, places.shape)
    grid, fine = np.arange(angles) * 360.0 / angles, np.arange(-10.0, 370.0, 0.05)

    def curve(size, orders):
        a, b = rng.normal(0.0, size / np.sqrt(len(orders)), (2, len(orders)))
        phase = np.multiply.outer(fine * DEGREE, orders)
        return np.cos(phase) @ a + np.sin(phase) @ b

    both = [curve(size, np.arange(2, 6)) for size in 3 * [5e-7] + 3 * [2.0 * ARCSEC]]
    half = [curve(0.1 * size, np.arange(2, 5)) for size in 3 * [5e-7] + 3 * [2.0 * ARCSEC]]
    rows, readings, turn, window = [], [], 0, min(window_deg, 180.0 / angles)
    for place in range(3):
        for target in range(targets):
            for run, sense in enumerate((1.0, -1.0)):
                time = np.arange(0.0, 364.0 / speed_deg_s, 1.0 / RATE_HZ)
                shown = (-2.0 if sense > 0 else 362.0) + sense * speed_deg_s * time
                off = [np.interp(shown, fine, both[c] + sense * half[c]) for c in range(6)]
                ahead = (shown + sense * speed_deg_s * lag) * DEGREE
                arm = np.repeat(stood[place][None], len(time), axis=0)
                arm = turned(0.0 * ahead, 0.0 * ahead, ahead, arm)
                stands = turned(*off[3:], arm) + np.column_stack(off[:3])
                error = rng.normal(0.0, noise, len(time))
                if correlated_s:
                    keeps = np.exp(-1.0 / (RATE_HZ * correlated_s))
                    error = lfilter([np.sqrt(1.0 - keeps**2)], [1.0, -keeps], error)
                read = np.linalg.norm(stands - true[target], axis=1) + error + rng.normal()
                start = readings[-1][-1, 0] + 5.0 if readings else 0.0
                readings.append(np.column_stack([start + time, shown, read]))
                for k in range(angles)[:: int(sense)]:
                    away = shown - grid[k]
                    near = np.abs(away) < window
                    value = np.polynomial.polynomial.polyfit(away[near], read[near], 3)[0]
                    speed = sense * speed_deg_s * DEGREE
                    rows.append((k, run, place, target, speed, value, turn))
                turn += 1
    angle, run, place, target, speed, length, turn = np.array(rows).T
    curves = [[np.interp(grid, fine, both[c] + s * half[c]) for s in (1, -1)] for c in range(6)]
    return SixTurningScene(
        *(each.astype(int) for each in (angle, run, place, target)), speed, length,
        turn.astype(int), grid * DEGREE, np.array(curves), nominal, places,
        readings,
    )  # fmt: skip
