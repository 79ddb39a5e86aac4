import numpy as np
import pytest

from rotcal_ros.evaluation.harmonics import harmonic_content
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError

TAU = 2.0 * np.pi
ANGLES = np.arange(36) * TAU / 36


def to_first(n):
    matrix = np.eye(n)
    matrix[:, 0] -= 1.0
    return matrix


def test_amplitude_and_phase_of_known_harmonics():
    values = 7.0 + 3.0 * np.cos(ANGLES - 0.5) + 0.2 * np.cos(4 * ANGLES + 2.0)
    got = harmonic_content(MeasuredCurve(ANGLES, values, np.zeros((36, 36)), TAU))
    np.testing.assert_allclose(got.amplitude[[0, 3]], [3.0, 0.2], atol=1e-12)
    np.testing.assert_allclose(got.phase[[0, 3]], [0.5, -2.0], atol=1e-11)
    assert np.max(np.delete(got.amplitude, [0, 3])) < 1e-12
    assert got.residual_rms < 1e-12
    assert len(got.orders) == 12


def test_independent_noise_in_closed_form():
    """Equal noise s at n even angles: s sqrt(2/n) in amplitude, s sqrt(2/n)/a in phase."""
    values = 3.0 * np.cos(ANGLES - 0.5)
    for shape in (np.eye(36), to_first(36)):
        curve = MeasuredCurve(ANGLES, shape @ values, 0.04 * shape @ shape.T, TAU)
        got = harmonic_content(curve)
        expected = 0.2 * np.sqrt(2 / 36)
        np.testing.assert_allclose(got.amplitude_std, expected, rtol=1e-6)
        assert got.phase_std[0] == pytest.approx(expected / 3.0, rel=1e-6)


def test_agrees_with_the_discrete_fourier_transform():
    values = np.random.default_rng(5).normal(size=36)
    got = harmonic_content(MeasuredCurve(ANGLES, values, np.eye(36), TAU), 17)
    spectrum = np.fft.rfft(values)[1:18] / 18
    np.testing.assert_allclose(got.cosine, spectrum.real, atol=1e-12)
    np.testing.assert_allclose(got.sine, -spectrum.imag, atol=1e-12)


def test_uneven_angles_and_correlated_noise_in_simulation():
    rng = np.random.default_rng(6)
    angles = np.sort(rng.uniform(0.0, TAU, 30))
    shape = 0.05 * rng.normal(size=(30, 30)) + 0.1 * np.eye(30)
    values = 2.0 * np.cos(2 * angles - 1.0)
    runs = [
        harmonic_content(
            MeasuredCurve(angles, values + shape @ rng.normal(size=30), shape @ shape.T, TAU), 4
        )
        for _ in range(800)
    ]
    amplitude = np.array([r.amplitude[1] for r in runs])
    phase = np.array([r.phase[1] for r in runs])
    assert np.mean(amplitude) == pytest.approx(2.0, abs=0.01)
    assert np.std(amplitude) == pytest.approx(runs[0].amplitude_std[1], rel=0.08)
    assert np.std(phase) == pytest.approx(runs[0].phase_std[1], rel=0.08)
    false_alarms = np.mean([r.significant[[0, 2, 3]] for r in runs])
    assert false_alarms == pytest.approx(0.05, abs=0.02)
    assert all(r.significant[1] for r in runs)


def test_what_cannot_be_told_is_refused():
    with pytest.raises(DataError, match="arc only"):
        harmonic_content(MeasuredCurve(ANGLES[:9], ANGLES[:9], np.eye(9), 0.0))
    with pytest.raises(DataError, match="at most 17"):
        harmonic_content(MeasuredCurve(ANGLES, ANGLES, np.eye(36), TAU), 18)
    bunched = np.linspace(0.0, 1e-4, 36)
    with pytest.raises(DataError, match="cannot separate"):
        harmonic_content(MeasuredCurve(bunched, bunched, np.eye(36), TAU), 5)
