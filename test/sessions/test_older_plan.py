"""Bags of plans that measured the nests of a station once: read as ever, not continued."""

from pathlib import Path

import pytest

from rotcal_ros.catalogue import prepare
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.sessions import resume

BAG = Path(__file__).parents[1] / "golden" / "plane_mirror" / "bag"


def test_a_bag_is_read_with_the_plan_that_was_measured():
    recording = read_recording(BAG)
    assert len(recording.calibration.plan.steps) == len(recording.observations) == 36
    again = read_recording(BAG, configuration=recording.calibration.configuration)
    assert again.calibration.plan == recording.calibration.plan
    assert "drift" in recording.solve().unprotected
    assert len(prepare(recording.calibration.configuration).plan.steps) == 36 + 2 * 6


def test_a_session_of_an_earlier_plan_is_not_continued():
    calibration = prepare(read_recording(BAG).calibration.configuration)
    with pytest.raises(ConfigurationError, match="begun by an earlier version"):
        resume._observed(BAG, calibration)
