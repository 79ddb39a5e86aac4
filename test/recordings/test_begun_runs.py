"""A run begins afresh offline as live: what an instrument said before it does not reach in."""

from types import SimpleNamespace

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.recordings.streams import StreamFeeder


def test_interpreter_and_finder_are_new_with_every_run():
    finders = []

    def make_finder():
        finders.append(SimpleNamespace(ordered=bool(finders)))
        return finders[-1]

    feeder = StreamFeeder(lambda run: SimpleNamespace(run=run), make_finder=make_finder)
    one = np.ones((1, 1))
    numbers = []
    for run in (0, 1):
        if run:
            feeder.begin_run(run)
        for row in range(2):
            at = np.array([row], np.int64)
            reading = feeder._instruments.bare(names.TRACER_LENGTH, at, at, at, one)
            numbers += reading["sequence"].tolist()
    assert numbers == [0, 1, 0, 1]
    assert len(finders) == 2
    assert feeder._finder is finders[1]
    assert not finders[1].ordered  # as known of the run before
