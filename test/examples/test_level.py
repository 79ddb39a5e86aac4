"""Levels on the table against rotations and gravity: signs, truth, uncertainty, refusals."""

import re
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import chances
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rotcal_level.method import METHOD, plan, states
from rotcal_level.model import model_of
from rotcal_level.settings import LevelPlanSettings, LevelSolverSettings
from rotcal_ros.adjust import engine
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import EFFECTS, unprotected
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.planning.readings import Readings

SIGMA = 0.1 * ARCSEC
SOLVER = LevelSolverSettings(sigma_arcsec=0.1, azimuth_std_deg=0.5)
PLAN = LevelPlanSettings()
UNEVEN = (0, 20, 50, 90, 140, 200, 270, 330)
RUNS = 400 if chances.LONG else 60


def test_the_page_says_where_the_names_are():
    page = (Path(__file__).parents[2] / "examples" / "own_method" / "README.md").read_text()
    rows = re.findall(r"^\| (`.*`.*) \| `([a-z_.]+)` \|$", page, re.M)
    assert len(rows) > 15
    for names, module in rows:
        found = import_module(f"rotcal_ros.{module}")
        for name in re.findall("`([A-Za-z_]+)`", names):
            assert hasattr(found, name) or find_spec(f"rotcal_ros.{module}.{name}"), (module, name)


def configured(settings):
    return SimpleNamespace(plan=settings, solver=SOLVER, source="here")


class World:
    """A table that turns by rotation matrices, and levels that feel gravity on it.

    ``tilts`` (2, n): EAC, EBC at the angles of the plan; ``lean`` (2,) of the axis about x and y.
    The levels stand ``off`` (k,) their azimuths, all rad, on a surface that is not square.
    """

    def __init__(self, settings, seed=1, lean=(20.0, -15.0), size=1.0, off_deg=0.5):
        rng = np.random.default_rng(seed)
        self.settings, self.steps = settings, plan(configured(settings)).steps
        self.angles = np.array(plan(configured(settings)).table_angles)
        k = len(settings.azimuths_deg)
        self.tilts = size * ARCSEC * rng.standard_normal((2, len(self.angles)))
        self.lean, self.surface = np.array(lean) * ARCSEC, 30.0 * ARCSEC * rng.standard_normal(2)
        self.off = off_deg * DEGREE * rng.standard_normal(k)
        self.zeros = 20.0 * ARCSEC * rng.standard_normal(k)
        self.position, self.level = (
            np.array([getattr(step, name) for step in self.steps])
            for name in ("table_position", "target")
        )
        self.order = np.array([np.sum(self.level[:i] == q) for i, q in enumerate(self.level)])
        self.value = self.readings(self.tilts, self.off, self.zeros, self.lean)

    def readings(self, tilts, off, zeros, lean):
        """Return what the levels read, rad: how far they point above the horizon, and zeros."""
        turned = Rotation.from_euler("z", self.angles[self.position][:, None])
        tilted = Rotation.from_rotvec(np.pad(tilts, ((0, 1), (0, 0)))[:, self.position].T)
        axis, surface = (Rotation.from_rotvec([*v, 0.0]) for v in (lean, self.surface))
        azimuth = np.array(self.settings.azimuths_deg) * DEGREE + off
        along = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth])
        points = (axis * tilted * turned * surface).apply(along[self.level])
        gravity = np.array([0.0, 0.0, -1.0])
        return np.pi / 2.0 - np.arccos(points @ -gravity) + zeros[self.level]

    def visible(self, tilts):
        """Return EAC and EBC (2, n) without their mean and the part that turns, and the mean."""
        w = tilts[0] + 1j * tilts[1]
        fixed_and_turning = np.column_stack([np.ones(len(w)), np.exp(1j * self.angles)])
        mean, turning = np.linalg.lstsq(fixed_and_turning, w, rcond=None)[0]
        w = w - fixed_and_turning @ [mean, turning]
        return np.array([w.real, w.imag]), np.array([mean.real, mean.imag])

    @property
    def true(self):
        return self.visible(self.tilts)[0]

    def model(self, value=None, keep=slice(None), solver=SOLVER):
        value = self.value if value is None else value
        columns = (self.position, self.level, np.array([s.station for s in self.steps]), value)
        read = Readings(*(c[keep] for c in (*columns, np.arange(len(value)))))
        return model_of(self.settings, solver, read)

    def noisy(self, rng):
        return self.value + SIGMA * rng.standard_normal(len(self.value))


@pytest.mark.parametrize(
    "settings",
    [
        PLAN,
        LevelPlanSettings(azimuths_deg=(0, 60, 120), levels=1),
        LevelPlanSettings(table_angles_deg=UNEVEN, azimuths_deg=(10, 80, 200, 240, 310, 120)),
        LevelPlanSettings(azimuths_deg=(0, 90), closing=False),
    ],
)
def test_exact_readings_give_the_truth(settings):
    world = World(settings, off_deg=0.0)
    found = engine.adjust(world.model())
    assert found.value.reshape(2, -1) == pytest.approx(world.true, abs=1e-5 * ARCSEC)
    lean = world.lean + world.visible(world.tilts)[1]
    assert found.further["lean of the axis"][0] == pytest.approx(lean, abs=1e-5 * ARCSEC)
    found = engine.adjust(world.model(world.noisy(np.random.default_rng(1))))
    k, n = len(settings.azimuths_deg), len(world.angles)
    assert found.fit.dof == len(world.value) - (2 * n + k - 2)
    assert (found.verdict, len(found.doubts)) == (("ok", 0) if found.fit.dof else ("suspect", 1))


def test_the_signs_are_those_of_the_conventions():
    """Turned by +4 arcsec about x the table lifts its +y side, about y it lowers its +x side."""
    for about, azimuth, sign in ((0, 90.0, 1.0), (1, 0.0, -1.0)):
        settings = LevelPlanSettings(azimuths_deg=(azimuth, azimuth + 60.0), levels=2)
        world = World(settings, lean=(0.0, 0.0), size=0.0, off_deg=0.0)
        level = (world.position == 0) & (world.level == 0)
        flat = world.value[level]
        world.tilts[about, 0] = 4.0 * ARCSEC
        value = world.readings(world.tilts, world.off, world.zeros, world.lean)
        assert value[level] - flat == pytest.approx(sign * 4.0 * ARCSEC, rel=1e-6)
        found = engine.adjust(world.model(value)).value.reshape(2, -1)
        assert found == pytest.approx(world.true, abs=1e-5 * ARCSEC)


def test_the_same_as_dense_least_squares():
    """Independent: rotations, differentiated by differences; a row holds what is open."""
    world = World(PLAN)
    value, n, k = world.noisy(np.random.default_rng(3)), 12, 4

    def whitened(x):
        off, zeros = x[2 * n + k :], x[2 * n : 2 * n + k] * ARCSEC
        computed = world.readings(x[: 2 * n].reshape(2, n) * ARCSEC, off * DEGREE, zeros, (0, 0))
        turning = np.exp(-1j * world.angles) @ (x[:n] + 1j * x[n : 2 * n])
        return np.concatenate(
            [(computed - value) / SIGMA, off / 0.5, [turning.real, turning.imag]]
        )

    dense = least_squares(whitened, np.zeros(2 * n + 2 * k), jac="3-point", xtol=1e-14)
    found = engine.adjust(world.model(value))
    tilts, lean = world.visible(dense.x[: 2 * n].reshape(2, n) * ARCSEC)
    assert found.value.reshape(2, n) == pytest.approx(tilts, abs=1e-4 * ARCSEC)
    assert found.further["lean of the axis"][0] == pytest.approx(lean, abs=1e-4 * ARCSEC)
    off, std = found.further["azimuth error"]
    assert off == pytest.approx(dense.x[-k:] * DEGREE, abs=1e-3 * DEGREE)
    units = np.eye(2 * n).reshape(-1, 2, n)
    project = np.array([world.visible(unit)[0].ravel() for unit in units])
    inverse = np.linalg.inv(dense.jac.T @ dense.jac)
    expected = project @ inverse[: 2 * n, : 2 * n] @ project
    assert found.covariance / ARCSEC**2 == pytest.approx(expected, abs=1e-3 * expected.max())
    assert std / DEGREE == pytest.approx(np.sqrt(inverse.diagonal()[-k:]), rel=1e-3)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """With levels that stand as far off their azimuths as stated, on a table that leans."""
    inside, square = [], []
    for run in range(RUNS):
        world = World(PLAN, seed=run)
        found = engine.adjust(world.model(world.noisy(np.random.default_rng([run, 1]))))
        error = found.value - world.true.ravel()
        inside.append(np.abs(error) <= 1.96 * found.std)
        square.append(error @ np.linalg.pinv(found.covariance, rcond=1e-6) @ error)
    low, high = chances.share(0.95, RUNS)
    assert low < np.mean(inside) < high
    low, high = chances.scatter(20 * RUNS)
    assert low < np.mean(square) / 20 < high  # 24 numbers without mean and turning part
    drawn = found.trials(np.random.default_rng(2), 20000)
    largest = found.covariance.max()
    assert np.cov(drawn.T) == pytest.approx(found.covariance, abs=0.05 * largest)


def test_the_axes_of_the_machine_and_the_order_change_nothing():
    """Turn the fixed axes by 30 deg, and read everything from the last to the first."""
    world, value = World(PLAN), World(PLAN).noisy(np.random.default_rng(5))
    one = engine.adjust(world.model(value)).value.reshape(2, -1)
    turned = World(replace(PLAN, table_start_deg=30.0)).model(value)
    two = engine.adjust(turned).value.reshape(2, -1)
    assert two[0] + 1j * two[1] == pytest.approx(
        (one[0] + 1j * one[1]) * np.exp(30j * DEGREE), abs=1e-6 * ARCSEC
    )
    back = engine.adjust(world.model(value, keep=slice(None, None, -1)))
    assert back.value == pytest.approx(one.ravel(), abs=1e-6 * ARCSEC)


def test_a_level_beside_its_azimuth_is_found_where_the_axis_leans_and_doubted_beyond_its_std():
    world = World(PLAN, off_deg=0.0)
    for off_deg, verdict in ((0.6, "ok"), (8.0, "suspect")):
        world.off[2] = off_deg * DEGREE
        world.value = world.readings(world.tilts, world.off, world.zeros, world.lean)
        found = engine.adjust(world.model(world.noisy(np.random.default_rng(8))))
        off, std = found.further["azimuth error"]
        assert (np.abs(off - world.off) < 3.0 * std).all()
        assert (np.abs(found.value - world.true.ravel()) < 4.5 * found.std).all()
        assert found.verdict == verdict
    assert found.doubts[0].startswith("the scatter of the azimuths is ")


def spoiled(world):
    """Yield what happens, with the readings (n,) that it spoils and what is said first."""
    yield "", 4.0 * ARCSEC * (np.arange(52) == 17)
    knocked = 2.0 * ARCSEC * ((world.level == 3) & (world.order >= 6))
    yield "the level moved from level 3, position 6 on, by ", knocked
    yield "the level drifts", 2.0 * ARCSEC * (world.level == 1) * world.order / 12.0
    lean = world.lean + np.array([3.0 * ARCSEC, 0.0])
    tilting = world.readings(world.tilts, world.off, world.zeros, lean) - world.value
    yield "the base of the table tilts", tilting * np.arange(52) / 51.0


@pytest.mark.parametrize("number", range(4))
def test_what_spoils_readings_is_left_out_or_taken_off_and_told(number):
    world = World(PLAN)
    words, error = list(spoiled(world))[number]
    found = engine.adjust(world.model(world.noisy(np.random.default_rng(7)) + error))
    assert (np.abs(found.value - world.true.ravel()) < 4.5 * found.std).all()
    assert list(found.why) == ([] if words else [17])
    assert [d.startswith(f"it looks as if {words}") for d in found.doubts[:1]] == [True] * bool(
        words
    )


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"azimuths_deg": (30, 210)}, PlanError, "add a second level at 90 deg to the first"),
        ({"azimuths_deg": (0,), "levels": 1}, PlanError, "or a setting with the level turned"),
        ({"table_positions": 2}, PlanError, "measure at 3 or more"),
        ({"azimuths_deg": (0, 90, 180)}, ConfigurationError, "3 azimuths for 2 levels"),
    ],
)
def test_plans_that_tell_too_little_are_refused(settings, error, words):
    with pytest.raises(error, match=words):
        plan(configured(LevelPlanSettings(**settings)))


def test_what_missing_readings_leave_open_is_named():
    world = World(PLAN)
    some = engine.adjust(world.model(keep=(world.position != 7) | (world.level < 2)))
    assert some.std[7] > 1.3 * some.std[6]
    with pytest.raises(ObservabilityError, match=r"cannot separate .*E[AB]C 7"):
        engine.adjust(world.model(keep=(world.position != 7) | (world.level == 2)))
    with pytest.raises(ObservabilityError, match="determines EAC 7, EBC 7: measure them"):
        engine.adjust(world.model(keep=world.position != 7))


@pytest.mark.parametrize(
    ("settings", "more"),
    [
        ({}, ()),
        ({"azimuths_deg": (0, 90)}, ("axis noise", "repeatability", "single readings")),
    ],
)
def test_all_nine_effects_are_stated_and_what_the_readings_cannot_show_is_named(settings, more):
    world = World(LevelPlanSettings(**settings))
    found = engine.adjust(world.model(world.noisy(np.random.default_rng(1))))
    said = states(configured(world.settings), None, found, None).protections
    result = found.result(
        "level", world.angles, {"EAC": slice(12), "EBC": slice(12, 24)},
        (world.position, world.level), counts_from="mean", protections=said,
    )  # fmt: skip
    assert [p.effect for p in result.protections if p.effect in EFFECTS] == list(EFFECTS)
    always = {"drift", "recurring drift", "knock", "scale", "one place", "sign of readings"}
    bare = always | {*more}
    assert set(unprotected(result.protections)) == bare


def test_a_plan_is_predicted_as_its_readings_are_solved():
    """For a table that does not lean, where azimuths do no harm."""
    world = World(PLAN, lean=(0.0, 0.0), size=0.0)
    std = engine.predicted(world.model()).std
    assert std == pytest.approx(engine.adjust(world.model()).std, rel=1e-6)
    assert std[1:12] == pytest.approx(SIGMA * np.sqrt(1 / 2 * 10 / 12), rel=0.05)


@pytest.mark.parametrize("effect", [None, "drift", "knock", "repeatability", "axis noise"])
def test_measurements_are_spoiled_on_purpose_and_the_verdict_shows_it(effect):
    configuration, planned = configured(PLAN), plan(configured(PLAN))
    sizes = {effect: 5.0 if effect == "axis noise" else 3.0 * ARCSEC} if effect else {}
    measured = METHOD.disturbances.measure(configuration, planned, sizes, 3)
    result = METHOD.solve(configuration, planned, measured.observations)
    assert (result.verdict == "ok") is (effect is None)
    for name in ("EAC", "EBC"):
        error = result.deviations[name] - measured.truth[name]
        assert effect or (np.abs(error) < 4.5 * result.std[name]).all()


def test_the_plan_asks_for_each_setting_and_ends_it_where_it_began():
    planned = plan(configured(PLAN))
    assert {step.kind for step in planned.steps} == {PointKind.READING}
    assert [step.table_position for step in planned.steps[22:30]] == [11, 11, 0, 0, 0, 0, 1, 1]
    assert [pause.first for pause in planned.pauses] == [0, 26]
    told = "at 0 deg put the levels so that they point to 135, 225 deg"
    assert told in planned.pauses[1].instruction
