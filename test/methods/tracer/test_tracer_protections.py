"""What a tracer result says about the effects that could spoil it, against effects put in."""

import numpy as np
import pytest
from chances import LONG
from coded import coded

from rotcal_ros.foundation.protection import EFFECTS
from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.reporting import ALONG_ITS_CIRCLE
from rotcal_ros.methods.tracer.solver.solve import LIKE_THE_TABLE

STATIONS, TARGETS, RADIUS = 12, 24, 0.09
LENGTH, TARGET = 2e-7, 1e-6
RUNS = 20 if LONG else 8


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


def along(size, wave):
    """Mount or cable shift the tracer along its circle: by ``size`` times ``wave`` (m,)."""

    def effect(share, at, to):
        tangent = np.stack([-at[..., 1], at[..., 0], 0.0 * at[..., 0]], axis=-1) / RADIUS
        return at + size * wave[:, None, None] * tangent, to

    return effect


def treatments(result):
    return {p.effect: p for p in result.protections}


@pytest.mark.parametrize("variant", ["joint", "station"])
@pytest.mark.parametrize("datum", ["prior", "free"])
def test_every_effect_is_stated_once(variant, datum):
    result = solve(measured(1, variant=variant, datum=datum))
    others = {"tangential motion", "recurring drift", "one place", "numbering", "single readings"}
    names = [p.effect for p in result.protections]
    assert tuple(names[: len(EFFECTS)]) == EFFECTS
    assert sorted(names[len(EFFECTS) :]) == sorted(others)
    stated = treatments(result)
    assert stated["gauge"].treatment == "harmless"
    assert {"drift", "knock", "repeatability"} <= set(result.unprotected)
    assert result.verdict_line.startswith("ok. Not tested for: drift, knock")


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


@pytest.mark.parametrize("stated", [None, 0.0, 1e-7])
@pytest.mark.parametrize("interleaved", [False, True])
def test_a_tracer_shifted_along_its_circle_is_named_as_no_length_sees_it(stated, interleaved):
    """cos 2 theta of 0.6 um: the closed form of its error is -shift / radius."""
    wave = np.cos(4 * np.pi * np.arange(STATIONS) / STATIONS)
    options = {"interleaved": interleaved, "error_motion_std": stated}
    quiet = solve(measured(5, **options))
    result = solve(measured(5, effect=along(6e-7, wave), **options))
    assert quiet.verdict == result.verdict == "ok"  # nothing can see it
    moved = result.deviations["ECC"] - quiet.deviations["ECC"]
    assert moved == pytest.approx(6e-7 * (wave - wave[0]) / RADIUS, rel=1e-3, abs=1e-9)
    assert (np.abs(moved)[1:] / result.std["ECC"][1:]).max() > 3.0
    for found in (quiet, result):
        assert "tangential motion" in found.unprotected
        assert "tangential motion" in found.verdict_line
        why = treatments(found)["tangential motion"].why
        assert f"1 um of it is {1e-6 / RADIUS * 206264.806:.2f} arcsec" in why
        assert "no angle was measured again" in why
        assert found.details["returned"] == []
    if stated is None:
        assert (
            "radial part; the tangential part is taken" in treatments(result)["error motion"].why
        )


@pytest.mark.parametrize("crept", [0.0, 4e-7])
def test_a_closing_measurement_bounds_what_of_it_does_not_come_back(crept):
    """A cable that winds up: the tracer ends ``crept`` further along its circle."""
    wave, within = np.arange(STATIONS + 1) / STATIONS, []
    for seed in range(40 if LONG else 10):
        result = solve(measured(seed, turned=STATIONS + 1, effect=along(crept, wave)))
        (closing,) = result.details["returned"]
        assert (closing["first"], closing["last"]) == (0, STATIONS)
        within.append(closing["within"])
        (closure,) = result.details["closure"]
        assert closing["within"] == pytest.approx(
            RADIUS * (abs(closure["error"]) + 1.96 * closure["std"]), rel=1e-3
        )  # the table is stated to have no error motion
    assert np.mean(np.array(within) >= crept) >= (0.9 if LONG else 0.8)
    assert np.median(within) < crept + 4e-7  # a bound that says something
    stated = treatments(result)["tangential motion"]
    assert stated.treatment == "not protected"  # what comes back with the angle stays unseen
    assert f"less than {within[-1] / 1e-6:.2g} um" in stated.why
    assert f"(95 %, positions 0 and {STATIONS}, at the same angle)" in stated.why


def test_the_bound_holds_no_error_motion_which_would_widen_it():
    bare, wide = (
        solve(measured(6, turned=STATIONS + 1, error_motion_std=std)).details["returned"][0]
        for std in (0.0, 5e-6)
    )
    assert wide["within"] == pytest.approx(bare["within"], rel=0.1)


def test_an_origin_that_drifts_in_step_with_each_turn_is_named_where_the_table_turns_often():
    """Paper's order, full circle: 5 um per turn displace each station by the same every time.

    No residual grows, and only the closing position, if there is one, shows it.
    """
    share_of_turn = np.arange(STATIONS) / STATIONS

    def effect(_share, at, to):
        moved = np.sin(4 * np.pi * share_of_turn)[:, None, None] * np.array([0.0, 5e-6, 0.0])
        return at, to + moved

    options = {"interleaved": True, "error_motion_std": None}
    sound, spoilt = solve(measured(2, **options)), solve(measured(2, effect=effect, **options))
    assert spoilt.sigma0 == pytest.approx(sound.sigma0, abs=0.02)
    named = treatments(spoilt)["tangential motion"]
    assert named.treatment == "not protected"
    assert LIKE_THE_TABLE in coded(named.why)
    assert ALONG_ITS_CIRCLE in coded(named.why)
    once = treatments(solve(measured(2)))["tangential motion"]
    assert LIKE_THE_TABLE not in coded(once.why)


@pytest.mark.parametrize("size", [0.0, 1e-6])
def test_a_frame_that_swings_in_each_turn_alike_is_named_where_the_turns_do_not_show_it(size):
    """It moves every station by the same each time: the circle shows its radial part alone."""

    def swinging(share, at, to):
        wave = np.sin(2.0 * np.pi * share * TARGETS)[:, :, None]
        return at, to + size * wave * [0.0, 0.0, 1.0]

    result = solve(measured(3, interleaved=True, effect=swinging))
    assert (result.verdict == "ok") == (size == 0.0) or "recurring drift" in result.unprotected
