"""A fringe that slips unseen: what is found of it, and what of it the uncertainty holds."""

import numpy as np
import pytest
from chances import LONG
from coded import coded
from segment_scene import measure

from rotcal_ros.foundation.protection import EFFECTS, PARTICULAR
from rotcal_ros.methods.tracer.solver import solve
from rotcal_ros.methods.tracer.solver.solution import SLIPS_FOUND, adjust

FRINGE = 0.3164e-6


@pytest.mark.slow
def test_as_many_slips_are_found_as_is_stated():
    found, stated, runs = 0, [], 60 if LONG else 25
    for seed in range(runs):
        run = measure(seed, n=24, by_target=False)
        moment = np.random.default_rng([seed, 3]).integers(1, 168)
        solution = adjust(run.problem(0.5 + FRINGE * (np.arange(168) >= moment), 0))
        jumps = [e for e in solution.found.found_effects if e.effect.effect == "slip"]
        found += bool(jumps)
        if not jumps:
            stated.append(solution.slips.found)
    expected = np.mean(stated)
    assert 0.3 < expected < 0.9
    assert abs(found / runs - expected) < 3 * np.sqrt(expected * (1 - expected) / runs)


def test_the_result_says_how_many_slips_would_be_found():
    by_target, by_station = (
        {p.effect: p for p in solve(measure(n=40, by_target=b).problem(0.5, 0)).protections}
        for b in (True, False)
    )
    others = (
        "growth", "uneven drift", "sign of z", "sign of readings", "sense", "gain", "probe tip",
        "lag", "straightness", "play", "polygon tilt",
    )  # fmt: skip
    assert tuple(by_target) == (*EFFECTS, *(e for e in PARTICULAR if e not in others))
    assert by_target["slip"].treatment == "bounded"
    ((_, share),) = coded(by_target["slip"].why)[SLIPS_FOUND]
    assert round(share) == 1
    assert by_target["slip"].error < 0.6 < 1.0 < by_station["slip"].error
    apart = solve(measure().problem(zero=0.5, segment=None))
    assert "slip" not in {p.effect for p in apart.protections}
