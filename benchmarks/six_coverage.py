"""How often the stated 95 % intervals of the six curves hold the truth, and how wide they are."""

import argparse
from dataclasses import dataclass, replace

import numpy as np
from six_scene import good_targets, scene

from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT
from rotcal_ros.methods.tracer_six.solver import SixProblem, adjust

LEVELS = (0.5, 1.0, 2.0)
KINDS = {"shifts": (6.5e-8, 0.0), "turns": (0.0, 4.3e-7), "both": (5.2e-8, 2.6e-7)}
"""Scatter (m, rad) that doubles the variance of EAC and EBC, 864 lengths with one arrival."""
TWELVE = [0, 2, 3, 5, 8, 9, 10, 11, 14, 15, 18, 21]
"""Of the good targets, those that determine the six curves as well when each is measured twice."""
ALL = list(range(24))
CASES = {"one arrival": (1, ALL), "two arrivals, 12 targets": (2, TWELVE)}
NONE = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
BREAKS = {"3 breaks": ("per_segment", 3), "each angle": ("per_station", 0)}
"""Where the beam is broken, at random or at every angle of the table."""


@dataclass(frozen=True)
class Coverage:
    """``share`` (6,) of true values inside, and rms of ``error`` and ``std`` (6,), m and rad.

    ``jumped``: share of the measurements in which a zero was seen to jump.
    """

    share: np.ndarray
    error: np.ndarray
    std: np.ndarray
    jumped: float = 0.0


def coverage(
    runs, scatter, *, arrivals=1, chosen=ALL, seed=0, ignored=False, zero="per_run", breaks=0,
    slips=False, **options,
):  # fmt: skip
    """Simulate ``runs`` measurements with ``scatter`` (m, rad) and solve each.

    ``chosen`` of the good targets are measured; ``zero``, ``breaks``: as in a scene. ``ignored``:
    the scatter is stated to be none, and believed whatever the places say. ``slips``: in each
    measurement the counter slips one fringe at random.
    """
    rng, inside, errors, stds, jumped = np.random.default_rng(seed), [], [], [], 0
    targets = good_targets()[chosen]
    if ignored:
        options = NONE
    for _ in range(runs):
        truth = scene(rng, targets, scatter=scatter, arrivals=arrivals, zero=zero, breaks=breaks)
        problem = SixProblem(**truth.rows, **options)
        if slips:
            problem = slipped(problem, rng)
        if ignored:
            sure = replace(problem.settings, noise_significance=1e-30)
            problem = replace(problem, settings=sure)
        solution = adjust(problem)
        error = solution.deviations() - truth.truth
        std = solution.found.std.reshape(6, -1)
        inside.append((np.abs(error) < HALF_OF_95_PERCENT * std).mean(axis=1))
        errors.append((error**2).mean(axis=1))
        stds.append((std**2).mean(axis=1))
        jumped += any(e.effect.effect == "slip" for e in solution.found.found_effects)
    return Coverage(
        np.mean(inside, axis=0), np.sqrt(np.mean(errors, axis=0)), np.mean(np.sqrt(stds), axis=0),
        jumped / runs,
    )  # fmt: skip


def slipped(problem, rng):
    """Return ``problem`` with one place's lengths a fringe longer from some moment on."""
    time = problem.measuring_order
    at = rng.integers(len(time))
    here = problem.place == problem.place[time == at]
    return replace(problem, length=problem.length + problem.slip * (here & (time >= at)))


def sizes():
    """Return what scatters, its level, and its size in m and rad."""
    scattered = [
        (kind, level, (level * unit[0], level * unit[1]))
        for kind, unit in KINDS.items()
        for level in LEVELS
    ]
    return [("none", 0.0, (0.0, 0.0)), *scattered]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=int, nargs="?", default=100)
    parser.add_argument("--case", choices=CASES, action="append", help="default: all")
    parser.add_argument("--broken", action="store_true", help="the beam is broken on the way")
    parser.add_argument("--slips", action="store_true", help="the counter slips a fringe")
    parser.add_argument("--no-slip", action="store_true", help="it is known not to: slip_m is 0")
    parser.add_argument("--kind", choices=["none", *KINDS], action="append", help="default: all")
    chosen = parser.parse_args()
    options = {"slip": 0.0} if chosen.no_slip else {}
    names = "".join(f"{name:>7}" for name in COMPONENTS)
    print(f"{'':26}{'scatter':10}level {names}   {'U':6}{names} um, urad")
    if chosen.broken:
        for name, (zero, breaks) in BREAKS.items():
            found = coverage(chosen.runs, KINDS["both"], zero=zero, breaks=breaks)
            show(name, "both", 1.0, found)
        return
    for case in chosen.case or CASES:
        arrivals, targets = CASES[case]
        if chosen.slips:
            for kind in chosen.kind or ["both"]:
                size = KINDS.get(kind, (0.0, 0.0))
                found = coverage(chosen.runs, size, arrivals=arrivals, chosen=targets, slips=True)
                show(case, kind, 1.0, found)
                print(f"found in {100 * found.jumped:.0f} %", flush=True)
            continue
        for kind, level, size in sizes():
            if chosen.kind and kind not in chosen.kind:
                continue
            found = coverage(chosen.runs, size, arrivals=arrivals, chosen=targets, **options)
            show(case, kind, level, found)


def show(case, kind, level, found):
    """Print one line."""
    share = "".join(f"{100 * value:7.1f}" for value in found.share)
    wide = "".join(f"{2e6 * value:7.3f}" for value in found.std)
    print(f"{case:26}{kind:10}{level:5.1f} {share}   {'':6}{wide}", flush=True)


if __name__ == "__main__":
    main()
