"""Plans of a tracer of which few simulated runs show whether they keep their promise.

How many runs a promise takes is tried in test_promise.py; a plan's tests
ask what is done with them.
"""

from functools import partial

import pytest

from rotcal_design.tracer import ordering
from rotcal_ros.methods.tracer.policy import sequence as sequence_choice


def few_runs(monkeypatch: pytest.MonkeyPatch, runs: int) -> None:
    """Let the promise of a plan be tested by so many runs; orders are less polished."""
    monkeypatch.setattr(sequence_choice, "TRADES", 30)
    monkeypatch.setattr(
        ordering, "simulate_uncertainties", partial(ordering.simulate_uncertainties, looks=(runs,))
    )
