"""Bare angles: noise of a table that stands is no motion, and one that turns is seen turning."""

import numpy as np
import pytest

from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.instruments.interpreter import BareAngles
from rotcal_ros.foundation.units import ARCSEC, DEGREE

LIMIT = CaptureSettings().velocity_tolerance_deg_s * DEGREE


def velocities(angles, rate_hz):
    stamps = np.arange(len(angles)) * round(1e9 / rate_hz)
    bare = BareAngles(TopicSettings())
    return bare.feedback(np.arange(len(angles)), stamps, angles[:, None])["velocity"]


@pytest.mark.parametrize("rate_hz", [10, 50, 100, 200, 1000])
def test_noise_of_an_arcsecond_is_rest(rate_hz):
    """The difference of two angles is of sqrt(2) arcsec: over 0.1 s, 5.1 sigma to the limit."""
    noise = np.random.default_rng(5).normal(0.0, ARCSEC, 3000)
    assert np.mean(np.abs(velocities(noise, rate_hz)) > LIMIT) < 1e-3


def test_a_table_that_turns_is_seen_at_its_speed():
    angles = np.arange(100) * 0.01 * 5.0 * LIMIT
    assert velocities(angles, 100) == pytest.approx(5.0 * LIMIT)
