"""Sections of the page from messages: no uncertainty is shown that may not be stated."""

import math

import pytest

from rotcal_ros.foundation.units import ARCSEC

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytest.importorskip("starlette")


def solution(**changes):
    from rotcal_msgs.msg import DeviationArray

    values = {"angles": [0.0, math.pi], "ecc": [0.0, 3 * ARCSEC], "ecc_std": [0.0, 0.5 * ARCSEC],
              "final": True, "verdict": "ok"}  # fmt: skip
    return DeviationArray(**(values | changes))


def shown(message, tolerance_arcsec=0.0):
    from rotcal_ros.foundation.identity import Identity
    from rotcal_ros.nodes.operator_page import sections as page_sections

    return page_sections.deviations_section(message, Identity(tolerance_arcsec=tolerance_arcsec))


@pytest.mark.parametrize(
    ("tolerance_arcsec", "kind"), [(4.1, "within"), (3.5, "undecided"), (1.9, "beyond")]
)
def test_a_final_solution_has_two_marks(tolerance_arcsec, kind):
    about, against = shown(solution(), tolerance_arcsec).marks
    assert about.line == "measurement: ok"
    assert (against.kind, against.line) == (
        kind, f"tolerance: {kind} ±{tolerance_arcsec:g} arcsec (ECC)"
    )  # fmt: skip
    assert shown(solution(final=False), tolerance_arcsec).marks == ()


@pytest.mark.parametrize(
    ("line", "words", "remark"),
    [
        ("ok (SIMULATED)", "ok (SIMULATED)", ""),
        ("ok. Not tested for: knock", "ok", "Not tested for: knock"),
        ("", "ok", ""),
    ],
)
def test_the_mark_of_the_measurement_says_below_what_it_does_not_cover(line, words, remark):
    (about,) = shown(solution(verdict_line=line)).marks
    assert (about.kind, about.line, about.remark) == ("ok", f"measurement: {words}", remark)


def test_where_u_may_not_be_stated_the_tolerance_is_undecided():
    about, against = shown(solution(verdict="suspect", warnings=["it drifted"]), 1.9).marks
    assert (about.kind, against.kind) == ("suspect", "undecided")


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


def test_a_pause_is_a_task_that_counts_from_one():
    from pathlib import Path

    from rotcal_msgs.msg import Pause

    from rotcal_ros.methods.calibration import prepare
    from rotcal_ros.methods.configuration import read_configuration
    from rotcal_ros.nodes.operator_page import sections as page_sections

    config = Path(__file__).parents[2] / "config" / "tracer_six_demo.yaml"
    calibration = prepare(read_configuration(config))
    planned = calibration.plan.pauses[1]
    pause = Pause(waiting=True, kind=Pause.KIND_MOVE, what="tracer", station=1, step=planned.first,
                  position=planned.move.position, instruction=planned.instruction)  # fmt: skip
    pause.header.frame_id = "table"
    task = page_sections.operator_task(calibration, pause)
    assert (task.what, task.number, task.count, task.station) == ("tracer", 2, 3, 1)
    assert task.at == pytest.approx(planned.move.position)
    assert (task.rides, task.again) == (True, False)
    pause.instruction = f"not right yet: it moved; correct it ({planned.instruction})"
    assert page_sections.operator_task(calibration, pause).again
    pause.waiting = False
    assert page_sections.operator_task(calibration, pause) is None


def test_the_command_names_the_session_of_a_bag_that_is_here(tmp_path):
    from rotcal_ros.nodes.operator_page import sections as page_sections

    (tmp_path / "table" / "bag").mkdir(parents=True)
    assert page_sections.resume_command_line(str(tmp_path / "table" / "bag")) == ""
    (tmp_path / "table" / "configuration.yaml").write_text("method: tracer_multistation\n")
    assert page_sections.resume_command_line(str(tmp_path / "table" / "bag")).endswith(
        f"--resume {tmp_path / 'table'}"
    )
    assert page_sections.resume_command_line("") == ""


def test_a_drift_is_the_slope_of_the_last_hour_and_known_after_a_minute():
    from rotcal_ros.nodes.operator_page.node import drift_k_per_h

    hour = [(1.7e9 + 10.0 * k, 20.0 + 0.36 * k / 360.0) for k in range(361)]
    assert drift_k_per_h(tuple(hour)) == 0.36
    assert drift_k_per_h(((hour[0][0] - 60.0, 99.0), *hour)) == 0.36
    assert drift_k_per_h(tuple(hour[:6])) is None
    assert drift_k_per_h(tuple(hour[:7])) == 0.36
