"""What a tracer result says about the effects that could spoil it, against effects put in."""

from __future__ import annotations

import numpy as np
import pytest

from rotcal_ros.methods.tracer import TracerProblem, solve
from rotcal_ros.methods.tracer import disturbances as patterns
from rotcal_ros.methods.tracer.response import respond
from rotcal_ros.methods.tracer.solution import adjust
from rotcal_ros.protection import EFFECTS

STATIONS, TARGETS, RADIUS = 12, 24, 0.09
LENGTH, TARGET = 2e-7, 1e-6


def measured(seed, turned=STATIONS, interleaved=False, effect=None, **options):
    """A perfect table; ``effect(share, stations, targets)`` moves either, place by place.

    ``share`` (m, n) of the run had gone; stations and targets (m, n, 3) come back moved.
    ``interleaved``: all stations at each target in turn.
    """
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * np.arange(turned) / STATIONS
    fixed = np.random.default_rng(9)
    far, around = fixed.uniform(0.3, 0.6, TARGETS), np.arange(TARGETS) * 0.8
    said = np.stack(
        [far * np.cos(around), far * np.sin(around), fixed.uniform(0, 0.7, TARGETS)], axis=1
    )
    stations = np.stack(
        [RADIUS * np.cos(angles), RADIUS * np.sin(angles), np.full(turned, 0.15)], axis=1
    )
    j, i = np.divmod(np.arange(turned * TARGETS), TARGETS)
    order = i * turned + j if interleaved else np.arange(len(j))
    share = (order / (len(j) - 1)).reshape(turned, TARGETS)
    true = said + TARGET * rng.standard_normal(said.shape)
    standing = np.repeat(stations[:, None], TARGETS, axis=1)
    aimed = np.repeat(true[None], turned, axis=0)
    if effect is not None:
        standing, aimed = effect(share, standing, aimed)
    length = np.sqrt(((standing - aimed) ** 2).sum(axis=2)) - 0.4
    length = length + LENGTH * rng.standard_normal(length.shape)
    given = {"variant": "joint", "error_motion_std": 0.0, "order": order, **options}
    return TracerProblem(
        position=j, target=i, length=length.ravel(), length_std=LENGTH, targets=said,
        target_std=TARGET, table_angles=angles, **given,
    )  # fmt: skip


def drifting(size):
    return lambda share, at, to: (at, to + size * share[:, :, None] * [0.0, 1.0, 0.0])


def knocked(size):
    """The tracer slips outwards, half-way."""

    def effect(share, at, to):
        outward = at * [1, 1, 0] / RADIUS
        return at + size * (share >= 0.5)[:, :, None] * outward, to

    return effect


def treatments(result):
    return {p.effect: p for p in result.protections}


@pytest.mark.parametrize("variant", ["joint", "station"])
@pytest.mark.parametrize("datum", ["prior", "free"])
def test_every_effect_is_stated_once(variant, datum):
    result = solve(measured(1, variant=variant, datum=datum))
    assert tuple(p.effect for p in result.protections) == EFFECTS
    stated = treatments(result)
    assert stated["gauge"].treatment == "harmless"
    assert {"drift", "knock", "repeatability"} <= set(result.unprotected)
    assert result.verdict_line.startswith("ok, not protected against drift, knock")


def test_what_the_plan_and_the_settings_change():
    once, often = treatments(solve(measured(1))), treatments(solve(measured(1, interleaved=True)))
    assert once["repeatability"].treatment == "not protected"
    assert often["repeatability"].treatment == "tested"
    assert once["knock"].treatment == "not protected"  # along the circle nothing shows it
    closed = treatments(solve(measured(1, turned=STATIONS + 1)))
    assert closed["knock"].treatment == "tested"
    assert often["knock"].error < closed["knock"].error
    left_open = treatments(solve(measured(1, error_motion_std=None)))
    assert left_open["error motion"].treatment == left_open["tilt"].treatment == "estimated"
    assert once["error motion"].error > 2.0
    runs = treatments(solve(measured(1, turned=2 * STATIONS, repeated_runs=True)))
    assert runs["repeatability"].treatment == "estimated"


@pytest.mark.parametrize("interleaved", [False, True])
def test_response_is_what_the_solver_does(interleaved):
    quiet = measured(2, interleaved=interleaved)
    solution = adjust(quiet)
    when = patterns.timing(solution)
    slow, size = patterns.drifts(solution, when)[1:2], 2e-7
    moved = solve(measured(2, interleaved=interleaved, effect=drifting(size)))
    found = moved.deviations["ECC"] - solution.motion.cumulative
    said = respond(solution, slow).deviations[0] * size
    assert found == pytest.approx(said, abs=2e-2 * np.abs(said).max() + 1e-12)
    out = respond(solution, patterns.knocks(solution, when)[3:4]).deviations[0] * size
    moved = solve(measured(2, interleaved=interleaved, effect=knocked(size)))
    found = moved.deviations["ECC"] - solution.motion.cumulative
    assert found == pytest.approx(out, abs=2e-2 * np.abs(out).max() + 1e-12)


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize(
    ("effect", "pattern"),
    [(drifting, lambda s, w: patterns.drifts(s, w)[1:2]),
     (knocked, lambda s, w: patterns.knocks(s, w)[3:4])],
    ids=["drift", "knock"],
)  # fmt: skip
def test_what_is_called_detectable_turns_the_verdict(effect, pattern, interleaved):
    solution = adjust(measured(3, interleaved=interleaved))
    size = float(respond(solution, pattern(solution, patterns.timing(solution))).detectable[0])
    assert size < 1e-4
    verdicts = [
        solve(measured(100 + k, interleaved=interleaved, effect=effect(size))).verdict
        for k in range(20)
    ]
    assert verdicts.count("ok") <= 4  # 1 expected
    half = [
        solve(measured(100 + k, interleaved=interleaved, effect=effect(0.3 * size))).verdict
        for k in range(10)
    ]
    assert half.count("ok") >= 6  # not detectable by far


def test_a_leaning_axis_and_a_wrong_scale_hardly_touch_the_angle():
    lean, ppm = 1e-3, 20e-6
    leant = np.array(
        [[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]]
    )
    plain = solve(measured(4))
    tilted = solve(measured(4, effect=lambda share, at, to: (at @ leant, to)))
    change = tilted.deviations["ECC"] - plain.deviations["ECC"]
    assert np.abs(change).max() < 0.2 * plain.std["ECC"].max()
    longer = solve(measured(4, effect=lambda share, at, to: (at * (1 + ppm), to * (1 + ppm))))
    assert longer.verdict == "suspect"
    error = np.abs(longer.deviations["ECC"] - plain.deviations["ECC"])[1:] / plain.std["ECC"][1:]
    assert error.max() < 2.0
    assert treatments(plain)["scale"].error is None or treatments(plain)["scale"].error < 1.0
