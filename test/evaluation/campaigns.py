"""Simulated campaigns of one table: results with known noise, counted from zeros of their own."""

import numpy as np

from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

TAU = 2.0 * np.pi


def truth(t):
    return (8.0 * np.sin(t + 0.4) + 2.0 * np.cos(3 * t + 0.5)) * ARCSEC


def covariance(n, scale, rng):
    """A full covariance with correlations of some tenths."""
    mixing = np.eye(n) + 0.3 * rng.normal(size=(n, n)) / np.sqrt(n)
    return scale**2 * mixing @ np.diag(rng.uniform(0.5, 2.0, n)) @ mixing.T


def result_of(angles, values, cov, method="tracer_multistation", **more):
    """A result of ECC, or of what ``values`` maps."""
    values = values if isinstance(values, dict) else {"ECC": values}
    cov = cov if isinstance(cov, dict) else {"ECC": cov}
    return Result(
        method=method,
        angles=np.asarray(angles),
        deviations=values,
        std={c: np.sqrt(np.diag(m)) for c, m in cov.items()},
        covariance=cov,
        sigma0=1.0,
        dof=10,
        n_observations=100,
        **more,
    )


def from_first(values, cov):
    """Values counted from the first, as the tracer does."""
    turn = np.eye(len(values))
    turn[:, 0] -= 1.0
    return turn @ values, turn @ cov @ turn.T


def about_mean(values, cov):
    keep = np.eye(len(values)) - 1.0 / len(values)
    return keep @ values, keep @ cov @ keep


def campaign(angles, scale, rng, zero=from_first, extra=0.0):
    cov = covariance(len(angles), scale, rng)
    noise = np.linalg.cholesky(cov) @ rng.normal(size=len(angles))
    raw = truth(angles) + noise + rng.normal(0.0, extra, len(angles))
    return raw, cov, result_of(angles, *zero(raw, cov))


def combined(*results, **options):
    names = [f"r{k}" for k in range(len(results))]
    return combine(
        [CombinationInput.of(name, r) for name, r in zip(names, results, strict=True)], **options
    ).result


def three(rng, extra=0.0):
    """Three campaigns on a grid of 12 angles, one of which measured every second only."""
    grid = np.arange(12) * TAU / 12
    return [
        campaign(grid, 0.3 * ARCSEC, rng, from_first, extra),
        campaign(grid, 0.2 * ARCSEC, rng, about_mean, extra),
        campaign(grid[::2], 0.25 * ARCSEC, rng, from_first, extra),
    ]


def plate(grid, rng, shift=0.0, std=0.2e-6):
    """EXC, EYC of a plate: independent noise, then no mean and nothing that turns."""
    n = len(grid)
    curve = 3e-6 * np.cos(2 * grid + 0.3) + 1e-6 * np.exp(-1j * grid)
    noisy = curve + rng.normal(0.0, std, n) + 1j * rng.normal(0.0, std, n)
    basis = np.zeros((2 * n, 4))
    basis[:n, 0] = basis[n:, 1] = 1.0
    basis[:, 2] = np.append(np.cos(grid), np.sin(grid))
    basis[:, 3] = np.append(-np.sin(grid), np.cos(grid))
    q, _ = np.linalg.qr(basis)
    keep = np.eye(2 * n) - q @ q.T
    both, spread = keep @ np.append(noisy.real, noisy.imag), std**2 * keep
    aim = keep @ np.append(curve.real, curve.imag)
    moved = both + shift * basis[:, 2] - 2.0 * shift * basis[:, 3] + shift
    values = {"EXC": moved[:n], "EYC": moved[n:]}
    cov = {"EXC": spread[:n, :n], "EYC": spread[n:, n:]}
    return aim, result_of(grid, values, cov, "ball_plate")
