"""What is drawn, held against simulated truth and closed form."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods import prepare, read_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.nodes.scene.drawing import (
    COLOURS,
    DrawnDeviations,
    SceneLayout,
    SceneProgress,
    TargetState,
    Transform,
    draw_moving_shapes,
    draw_static_shapes,
    fixed_frames,
    make_layout,
    moving_frames,
)

CONFIG = Path(__file__).parents[3] / "config"


def calibration(name):
    return prepare(read_configuration(CONFIG / f"{name}.yaml"))


def named(shapes):
    return {shape.name: shape for shape in shapes}


@pytest.mark.parametrize("name", ["tracer_paper", "tracer_six_demo"])
def test_the_beam_is_as_long_as_an_exact_tracer_reads(name):
    known = calibration(name)
    layout = make_layout(known)
    dead = known.configuration.simulation.tracer.dead_distance_m
    exact = known.nominal_observations()
    for step, seen in list(zip(known.plan.steps, exact, strict=True))[::97]:
        beam = named(draw_moving_shapes(layout, step.table_angle, step))["beam"].points[0]
        assert np.linalg.norm(beam[1] - beam[0]) == pytest.approx(seen.mean[0] + dead, abs=1e-12)


def test_a_tracker_stands_still_at_its_radius_and_the_table_turns():
    layout = make_layout(calibration("plane_mirror_demo"))
    assert np.array_equal(layout.instruments(0.0), layout.instruments(1.0))
    radii = np.hypot(*layout.instruments(0.0)[:, :2].T)
    assert radii == pytest.approx(np.full(len(radii), 2.0))  # station_radius_m


def test_a_ball_plate_has_no_instrument_and_no_beam():
    known = calibration("ball_plate_demo")
    layout = make_layout(known)
    assert layout.radius == pytest.approx(1.2 * 0.185, rel=1e-3)  # circle_radius_m
    shapes = named(draw_moving_shapes(layout, 0.3, known.plan.steps[0]))
    assert set(shapes) == {"table", "zero mark"}


def test_the_world_turns_counter_clockwise_with_the_table():
    layout = make_layout(calibration("tracer_paper"))
    (x, y, z), *_ = layout.instruments(0.0).tolist()
    turned = layout.instruments(90 * DEGREE)[0]
    assert turned == pytest.approx([-y, x, z])
    mark = named(draw_moving_shapes(layout, 90 * DEGREE, None))["zero mark"].points[0]
    assert mark == pytest.approx(np.array([[0, 0, 0], [0, layout.radius, 0]]), abs=1e-15)


def test_the_frames_say_the_same_as_the_shapes():
    layout = make_layout(calibration("tracer_paper"))
    assert fixed_frames() == (Transform("machine", "table_base"),)
    table, tracer = moving_frames(layout, 0.7, None)
    assert (table.parent, table.child, table.angle) == ("table_base", "table", 0.7)
    assert (tracer.parent, tracer.child) == ("table", "tracer")
    x, y, z = tracer.translation
    c, s = np.cos(0.7), np.sin(0.7)
    assert layout.instruments(0.7)[0] == pytest.approx([c * x - s * y, s * x + c * y, z])


def test_the_errors_are_those_that_were_simulated_times_the_stated_factor():
    """The mark on the rim, moved by the true six deviations."""
    known = calibration("ball_plate_demo")
    angles = np.linspace(0.0, 2 * np.pi, 7)[:-1]
    truth = true_deviations(known.configuration.simulation.table, angles)
    shift = np.stack([truth[n] for n in ("EXC", "EYC", "EZC")], axis=1)
    turn = np.stack([truth[n] for n in ("EAC", "EBC", "ECC")], axis=1)
    layout = make_layout(known)
    shapes = named(
        draw_static_shapes(
            layout,
            (TargetState.OPEN,) * len(layout.places),
            DrawnDeviations(angles, shift, turn),
            5e4,
        )
    )
    assert shapes["exaggeration"].text == "errors x 50000"
    radius = layout.radius
    for (begin, end), angle, d, (a, b, c) in zip(
        shapes["errors"].points, angles, shift, turn, strict=True
    ):
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        assert begin == pytest.approx([x, y, 0.0])
        exact = [d[0] - c * y, d[1] + c * x, d[2] + a * y - b * x]  # first order in the angles
        assert (end - begin) / 5e4 == pytest.approx(exact, abs=1e-15)


def test_four_arcseconds_at_a_quarter_metre_are_drawn_a_tenth_of_a_metre_long():
    errors = DrawnDeviations(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 4.0 * ARCSEC]]))
    _, displacements = errors.displacements(0.25)
    assert 20000 * displacements[0] == pytest.approx([0.0, 0.09696, 0.0], abs=1e-5)


def test_every_place_has_the_colour_of_what_was_seen_there_last():
    known = calibration("tracer_paper")  # all stations at one target, then the next
    layout = make_layout(known)
    assert layout.places == known.plan.targets
    progress = SceneProgress(layout)
    assert set(progress.states) == {TargetState.OPEN}
    second = next(step for step in known.plan.steps if step.target == 1)
    progress.order(0)
    assert progress.states[:2] == (TargetState.CURRENT, TargetState.OPEN)
    progress.observe(0, accepted=False)
    assert progress.states[0] is TargetState.REJECTED
    progress.order(second.index)
    progress.observe(0, accepted=True)
    assert progress.states[:3] == (TargetState.DONE, TargetState.CURRENT, TargetState.OPEN)
    balls = named(draw_static_shapes(layout, progress.states, None, 1.0))["places"]
    assert balls.colours[0] == COLOURS[TargetState.DONE]
    assert len(balls.points) == len(balls.colours) == len(layout.places)
    assert len(set(COLOURS.values())) == len(TargetState)


def test_a_tracer_of_unknown_place_is_left_out():
    configuration = read_configuration(CONFIG / "tracer.yaml")
    known = prepare(configuration)
    layout = make_layout(known)
    assert isinstance(layout, SceneLayout)
    if not configuration.plan.tracer_m:
        assert layout.beam(known.plan.steps[0], 0.0) is None
