"""What a small turn of the table proves, with feedback and lengths made here."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.methods import prepare
from rotcal_ros.methods.check_lines import CellReport
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.methods.trial_motion import TrialMotion, beams_of, handedness_seen

CONFIG = Path(__file__).parents[2] / "config"
WAY = np.radians(5.0)
SETTINGS = CaptureSettings(settle_time_s=0.3)


def turn(*, ratio=1.0, velocity=1.0, table_late_s=0.0, creep_s=0.0, seen=1.0, **more):
    """Return a turn of 1 s that begins 0.2 s after its order at 1 s; 0.1 um of noise."""
    times = np.arange(0.0, 6.0, 0.02)

    def part(late_s=0.0, lasting_s=1.0):
        return np.clip((times - 1.2 - late_s) / lasting_s, 0.0, 1.0)

    moved = part(table_late_s)
    moving = ((moved > 0.0) & (moved < 1.0)) * WAY * ratio * velocity
    table = np.column_stack([times, 0.3 + ratio * WAY * moved, moving])
    noise = np.random.default_rng(11).normal(0.0, 1e-7, len(times))
    lengths = np.column_stack([times, 0.5 + 8e-3 * seen * part(0.0, 1.0 + creep_s) + noise])
    return TrialMotion(0.3, WAY, 1.0, table, lengths, **more)


def told(motion, beams=(8e-3, -3e-3)):
    return {line.name: line for line in motion.lines(SETTINGS, beams)}


def test_a_table_that_does_as_it_is_told_proves_all():
    lines = told(turn())
    assert {line.state for line in lines.values()} == {"good"}
    assert list(lines) == ["sign", "lag", "rest", "handedness"]
    assert "moved 0.2" in lines["lag"].found
    assert "at rest 1.2" in lines["rest"].found


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (-(0.3 + WAY), "a sign is wrong"),
        (0.3 - WAY, "a sign is wrong"),
        (np.degrees(0.3 + WAY), "the feedback is in degrees"),
        (np.radians(0.3 + WAY), "the order was taken for degrees"),
        (0.3 + 2 * WAY, "the feedback turned by +10°"),
        (0.3, "the table has not moved"),
    ],
)
def test_a_table_that_goes_elsewhere_is_told_why(end, words):
    lines = told(turn(ratio=(end - 0.3) / WAY))
    assert lines["sign"].state == "missing"
    assert words in lines["sign"].found
    assert ("handedness" in lines) == (end != 0.3)


def test_a_table_that_counts_its_turn_from_the_other_end_has_not_jumped():
    motion = turn()
    wrapped = motion.table.copy()
    wrapped[:, 1] = np.angle(np.exp(1j * (wrapped[:, 1] + np.pi - 0.3 - 0.5 * WAY)))
    lines = told(replace(motion, start=float(wrapped[0, 1]), table=wrapped))
    assert {line.state for line in lines.values()} == {"good"}


def test_rest_that_is_told_too_early_is_seen():
    assert told(turn(velocity=0.0))["rest"].state == "missing"
    assert "opposite signs" in told(turn(velocity=-1.0))["rest"].found
    late = told(turn(creep_s=1.0))["rest"]
    assert (late.state, late.todo) == ("doubt", "make capture.settle_time_s longer")
    assert told(turn(creep_s=0.2))["rest"].state == "good"


def test_feedback_that_comes_late_is_held_against_the_lengths():
    assert told(turn(table_late_s=0.6))["lag"].state == "doubt"
    assert told(turn(table_late_s=0.1))["lag"].state == "good"
    assert told(turn(seen=0.0, table_late_s=0.6), None)["lag"].state == "note"


def test_the_way_round_is_seen_by_the_lengths_or_by_a_person():
    assert told(turn(seen=-0.375))["handedness"].found.endswith("it turns clockwise")
    assert told(turn(seen=5.0))["handedness"].state == "doubt"
    open_line = told(turn(), None)["handedness"]
    assert open_line.state == "open"
    assert told(turn(), (8e-3, 7e-3))["handedness"].state == "open"  # the two look alike
    motion = turn(seen=0.0)
    assert (
        told(motion, (8e-3, -4e-4))["handedness"].state == "doubt"
    )  # nothing moved, or clockwise
    for heard in (motion.lengths[:0], motion.lengths[-10:], motion.lengths[:10]):
        lines = told(replace(motion, lengths=heard), (8e-3, -4e-4))
        assert (lines["handedness"].state, lines["lag"].state) == ("open", "note")
    report = CellReport("/cell", "", 5.0, (open_line,))
    for seen, state in (("clockwise", "missing"), ("counter-clockwise", "good")):
        assert handedness_seen(report, seen).lines[0].state == state
    assert handedness_seen(report, "unknown") == report


def test_what_ended_it_is_all_that_is_told():
    (line,) = turn(fault="emergency stop: pressed").lines(SETTINGS, None)
    assert (line.state, line.found) == ("missing", "emergency stop: pressed")


def test_beams_are_known_where_the_tracer_rides_at_a_stated_place():
    stated = ["plan.tracer_m=[0.3, 0.05, 0.15]"]
    calibration = prepare(changed(read_configuration(CONFIG / "tracer.yaml"), stated))
    probe = (0.31, -0.22, 0.74)
    well, wrong = beams_of(calibration, turn(probe=probe))
    place = np.array([0.3, 0.05, 0.15])

    def away(angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.linalg.norm(probe - np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ place)

    assert well == pytest.approx(away(0.3 + WAY) - away(0.3))
    assert wrong == pytest.approx(away(-0.3 - WAY) - away(-0.3))
    assert beams_of(calibration, turn()) is None
