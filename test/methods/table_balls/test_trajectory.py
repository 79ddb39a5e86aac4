"""Ranges of ISO 10791-6 against closed forms, and against transforms of another library."""

import numpy as np
import pytest
from ball_world import ONE, THREE, World
from scipy.spatial.transform import Rotation

from rotcal_ros.adjust.engine import adjust
from rotcal_ros.methods.table_balls.model import BallsOnTable, model_of
from rotcal_ros.methods.table_balls.settings import BallsPlanSettings
from rotcal_ros.methods.table_balls.trajectory import table_of_ranges, trajectories, way_figures

SIGMA = 1e-6


def ways_of(world, read):
    balls = BallsOnTable.of(world.plan, world.solver, read)
    return trajectories(balls, adjust(model_of(world.plan, world.solver, read)))


def test_an_axis_elsewhere_and_a_lean_make_ranges_of_known_size():
    """Balls missed by 0.3 mm: what stays with the table is in no range."""
    world = World(BallsPlanSettings(balls_m=THREE, axis_m=(0.0, 0.0, 0.06)))
    world.missed = 3e-4 * np.random.default_rng(1).standard_normal(world.missed.shape)
    ways = ways_of(world, world.readings())
    (x, y, a, b), ranges = world.axis, ways["ranges"]
    for ball, (bx, by, height) in enumerate(world.balls):
        phi, radius = world.angles + np.arctan2(by, bx), np.hypot(bx, by)
        out = (x + b * height) * np.cos(phi) + (y - a * height) * np.sin(phi)
        along = -(x + b * height) * np.sin(phi) + (y - a * height) * np.cos(phi)
        up = radius * (a * np.sin(phi) - b * np.cos(phi))
        assert ways["places"][ball] == pytest.approx([bx, by, height])
        found = ranges["value"][list(ranges["target"]).index(ball)]
        assert found == pytest.approx(
            np.ptp([out, along, up], axis=1), abs=2e-7
        )  # where a ball was missed
    assert ways["directions"] == ["radial", "tangential", "axial"]


def test_two_readings_at_an_end_make_it_less_uncertain():
    """The first angle is read once more at the end."""
    world = World(BallsPlanSettings(balls_m=ONE, axis_m=(0.0, 0.0, 0.06)))
    read = world.readings()
    counts = np.bincount(read.position)
    ways = ways_of(world, read)
    position = np.argmin(np.abs(np.subtract.outer(ways["angle"], world.angles)), axis=1)
    value, std = ways["value"], ways["ranges"]["std"][0]
    for k in range(3):
        ends = position[[value[:, k].argmax(), value[:, k].argmin()]]
        assert std[k] == pytest.approx(SIGMA * np.sqrt((1.0 / counts[ends]).sum()))


def test_at_each_tilt_the_ball_is_turned_back_by_both_axes():
    plan = BallsPlanSettings(
        balls_m=ONE, axis_m=(0.0, 0.0, 0.06), chain="AC", tilts_deg=(-40.0, 0.0, 50.0), runs=1,
        tilting_axis_m=(0.0, 0.02, -0.03),
    )  # fmt: skip
    world = World(plan)
    read = world.readings()
    ways = ways_of(world, read)
    foot, point = np.array(plan.axis_m), np.array(plan.tilting_axis_m)
    for tilt, degrees in enumerate(plan.tilts_deg):
        here = read.station == tilt
        flat = Rotation.from_euler("x", -degrees, degrees=True).apply(read.points[here] - point)
        turns = Rotation.from_euler("z", -world.angles[read.position[here], None])
        on_table = turns.apply(flat + point - foot)
        mean = [
            on_table[read.position[here] == at].mean(axis=0) for at in range(len(world.angles))
        ]
        azimuth = np.arctan2(ONE[1], ONE[0])
        turned = Rotation.from_euler("z", -azimuth).apply(mean)
        assert ways["ranges"]["tilt"][tilt] == tilt
        assert ways["ranges"]["value"][tilt] == pytest.approx(np.ptp(turned, axis=0), abs=1e-12)
    table = table_of_ranges({"trajectories": ways, "tilts": np.radians(plan.tilts_deg)})
    assert [row[table.head.index("tilt_deg")] for row in table.rows] == pytest.approx(
        plan.tilts_deg
    )


def test_a_ball_bar_has_the_range_of_its_lengths_and_no_circle():
    plan = BallsPlanSettings(
        balls_m=ONE, axis_m=(0.0, 0.0, 0.06), measure="bar",
        bars_m=(0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1),
    )  # fmt: skip
    world = World(plan)
    read = world.readings()
    ways = ways_of(world, read)
    assert ways["directions"] == ["length"]
    for bar in range(3):
        lengths = [
            read.value[(read.target == bar) & (read.position == at)].mean()
            for at in range(len(world.angles))
        ]
        assert ways["ranges"]["value"][bar, 0] == pytest.approx(np.ptp(lengths), abs=1e-12)
    assert way_figures(ways) == []


def test_a_circle_is_drawn_for_every_ball():
    world = World(BallsPlanSettings(balls_m=THREE, axis_m=(0.0, 0.0, 0.06)))
    (figure,) = way_figures(ways_of(world, world.readings()))
    assert all(f"ball {k}" in figure.svg for k in range(3))


@pytest.mark.parametrize("axis", [(4e-5, -3e-5, 2e-5, -5e-5), (0.0, 0.0, 0.0, 0.0)])
def test_a_ball_on_the_axis_and_one_that_is_nowhere_off_are_drawn(axis):
    """The second and third tilt alone were read: what is drawn is the first that there is."""
    plan = BallsPlanSettings(
        balls_m=(*ONE, 0.0, 0.0, 0.2), axis_m=(0.0, 0.0, 0.06), chain="AC", runs=1,
        tilts_deg=(-40.0, 0.0, 50.0), tilting_axis_m=(0.0, 0.02, -0.03),
    )  # fmt: skip
    ways = ways_of(World(plan, axis=axis), World(plan, axis=axis).readings())
    seen = ways["tilt"] > 0
    later = {n: ways[n][seen] for n in ("tilt", "target", "angle", "value", "std")}
    (figure,) = way_figures(ways | later)
    assert "nan" not in figure.svg
    assert all(f"ball {k}" in figure.svg for k in range(2))
