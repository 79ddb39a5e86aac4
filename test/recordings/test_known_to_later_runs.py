"""What of the streams counts where the nodes themselves went on after one of them had died."""

from dataclasses import replace
from types import SimpleNamespace

from rotcal_ros.bags import names
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.recordings.replay import keep_known_to_later_runs

OBSERVED = Observation(
    step=0, attempt=0, table_position=0, table_angle=0.1, target=0, station=0,
    kind=PointKind.REFLECTOR, mean=(1.0,), std=(1e-7,), scatter=(1e-7,),
    probe_position=(0.1, 0.2, 0.3), n_samples=5, n_used=5, accepted=True, reason="",
    table_angle_measured=0.1, temperature_c=None, window_start_ns=1, window_end_ns=2,
)  # fmt: skip


def noted(**note):
    return SimpleNamespace(metadata={names.RUN: {key: str(v) for key, v in note.items()}})


FIRST, UNREPORTED = OBSERVED, replace(OBSERVED, step=1)
LATER = replace(OBSERVED, step=1, run=1, attempt=1_000_000)


def test_what_no_run_of_the_nodes_has_known_does_not_count():
    scans = [noted(number=0), noted(number=1, earlier=names.RECORDED)]
    assert keep_known_to_later_runs([FIRST, UNREPORTED, LATER], [FIRST], scans) == (FIRST, LATER)


def test_a_resumed_run_went_on_from_the_streams_and_all_of_them_count():
    scans = [noted(number=0), noted(number=1)]
    assert keep_known_to_later_runs([FIRST, UNREPORTED, LATER], [FIRST], scans) == (
        FIRST,
        UNREPORTED,
        LATER,
    )


def test_a_bag_of_another_recorder_notes_no_runs():
    assert keep_known_to_later_runs([FIRST], [], [SimpleNamespace(metadata={})]) == (FIRST,)


def test_a_number_that_no_recorder_writes_is_no_run():
    scans = [noted(number="9" * 5000, earlier=names.RECORDED)]
    assert keep_known_to_later_runs([FIRST, UNREPORTED], [FIRST], scans) == (FIRST, UNREPORTED)
