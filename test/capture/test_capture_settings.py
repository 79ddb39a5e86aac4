"""Settings of the capture that have to fit each other."""

import pytest

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.foundation.errors import ConfigurationError


def test_settling_ends_before_the_timeout():
    assert CaptureSettings(settle_time_s=7.5, step_timeout_s=7.625).settle_time_s == 7.5
    words = (
        "settle_time_s = 7.5 leaves no time for a window; expected less than step_timeout_s = 7.5"
    )
    with pytest.raises(ConfigurationError, match=words):
        CaptureSettings(settle_time_s=7.5, step_timeout_s=7.5)
