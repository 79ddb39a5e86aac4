"""What a bag says of its recorder's clock."""

from types import SimpleNamespace

from rotcal_ros.bags import names
from rotcal_ros.bags.time_order import TimeOrder
from rotcal_ros.recordings.replay import describe_clock

SECOND = 1_000_000_000
NOON_NS = 1_700_000_000 * SECOND  # 2023-11-14T22:13:20Z
SET_BACK = TimeOrder(back=2, back_ns=45 * SECOND, apart_ns=45 * SECOND)


def scan(**note):
    return SimpleNamespace(metadata={names.CLOCK_JUMPS: note} if note else {})


def test_log_times_that_go_back_are_told():
    (text,) = describe_clock([scan()], SET_BACK)
    assert text.startswith("log times go back 2 times, by up to 45.0 s")
    assert describe_clock([scan()], TimeOrder()) == ()


def test_what_the_recorder_noted_is_told_in_its_place_the_great_jumps_first():
    jumps = scan(**{"0": f"{SECOND} {NOON_NS}", "1": f"{-45 * SECOND} {NOON_NS}"})
    assert describe_clock([jumps, jumps, scan()], SET_BACK) == (
        "the system clock jumped by -45.0 s at 2023-11-14T22:13:20Z",
        "the system clock jumped by +1.0 s at 2023-11-14T22:13:20Z",
    )


def test_many_jumps_are_counted():
    many = scan(**{str(n): f"{SECOND} {NOON_NS + n * SECOND}" for n in range(9)})
    texts = describe_clock([many], TimeOrder())
    assert len(texts) == 6
    assert texts[-1] == "the system clock jumped 4 more times"
