"""Sections of the page from messages: no uncertainty is shown that may not be stated."""

import math

import pytest

from rotcal_ros.units import ARCSEC

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytest.importorskip("starlette")


def solution(**changes):
    from rotcal_msgs.msg import DeviationArray

    values = {"angles": [0.0, math.pi], "ecc": [0.0, 3 * ARCSEC], "ecc_std": [0.0, 0.5 * ARCSEC],
              "final": True, "verdict": "ok"}  # fmt: skip
    return DeviationArray(**(values | changes))


def shown(message):
    from rotcal_ros.nodes import page_sections

    return page_sections.deviations(message)


def test_a_good_solution_shows_its_band_in_arcsec():
    found = shown(solution())
    assert found.withheld == ""
    assert found.curves[0].values == (0.0, 3.0)
    assert found.curves[0].expanded == (0.0, 1.0)  # k = 2


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_a_bad_verdict_shows_the_curve_and_the_reason_in_the_place_of_the_band(verdict):
    found = shown(solution(verdict=verdict, warnings=["it drifted"]))
    assert found.curves[0].values == (0.0, 3.0)
    assert found.curves[0].expanded == ()
    assert found.withheld == f"the verdict is {verdict}: it drifted"


def test_before_the_end_no_verdict_counts():
    assert shown(solution(final=False, verdict="suspect")).curves[0].expanded == (0.0, 1.0)


def test_an_uncertainty_that_is_not_known_is_not_shown_as_zero():
    assert shown(solution(ecc_std=[0.0, math.nan])).curves[0].expanded == (0.0, None)
    assert shown(solution(ecc_std=[0.0, math.inf])).curves[0].expanded == (0.0, None)
