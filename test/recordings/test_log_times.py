"""What a bag says of its recorder's clock."""

from types import SimpleNamespace

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.recordings.log_times import LogTimes, clock_in_words

SECOND = 1_000_000_000
NOON_NS = 1_700_000_000 * SECOND  # 2023-11-14T22:13:20Z


def looked(*blocks_s):
    times = LogTimes()
    for seconds in blocks_s:
        headers = np.zeros(len(seconds), [("log_time", np.uint64)])
        headers["log_time"] = [NOON_NS + round(s * SECOND) for s in seconds]
        times.look(SimpleNamespace(headers=headers))
    return times


def scan(**note):
    return SimpleNamespace(metadata={names.CLOCK_JUMPS: note} if note else {})


def test_log_times_that_go_back_are_told_also_between_blocks():
    times = looked([0, 1, 2, 2.5], [-42.5, -42, 3], [2.6, 1.5])
    assert (times.count, times.most_ns) == (2, 45 * SECOND)
    (text,) = clock_in_words([scan()], times)
    assert text.startswith("log times go back 2 times, by up to 45.0 s")
    assert clock_in_words([scan()], looked([0, 0.5, 0.2, 1], [])) == ()


def test_what_the_recorder_noted_is_told_in_its_place_the_great_jumps_first():
    jumps = scan(**{"0": f"{SECOND} {NOON_NS}", "1": f"{-45 * SECOND} {NOON_NS}"})
    assert clock_in_words([jumps, jumps, scan()], looked([0, -44])) == (
        "the system clock jumped by -45.0 s at 2023-11-14T22:13:20Z",
        "the system clock jumped by +1.0 s at 2023-11-14T22:13:20Z",
    )


def test_many_jumps_are_counted():
    many = scan(**{str(n): f"{SECOND} {NOON_NS + n * SECOND}" for n in range(9)})
    texts = clock_in_words([many], LogTimes())
    assert len(texts) == 6
    assert texts[-1] == "the system clock jumped 4 times more"
