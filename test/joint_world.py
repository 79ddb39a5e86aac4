"""One table, measured by two instruments that know nothing of each other: balls and a polygon."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from ball_world import LEVEL, NAMES, World

from rotcal_ros.evaluation.joint import JointInput
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.measurements import PlannedMeasurements

CONFIG = Path(__file__).parents[1] / "config"
BALLS_NOISE, POLYGON_NOISE = 1e-6, 0.05 * ARCSEC


def measured(name, changes, values):
    """Return the measurements of a demonstration with ``changes``; ``values`` by step."""
    calibration = prepare(changed(read_configuration(CONFIG / name), changes))
    steps = calibration.plan.steps
    seen = tuple(step.observed(value) for step, value in zip(steps, values(steps), strict=True))
    return PlannedMeasurements(calibration, seen)


def instrument(name, measurements):
    """Return measurements as an instrument: its result and its model."""
    model = measurements.calibration.model_of_curves(measurements.observations)
    return JointInput(name, measurements.solve(), model)


def balls(world, rng):
    """Return centres of two balls at one height, each twice and at the first angle once more."""

    def values(steps):
        centres = np.array([world.centre(s.table_position, s.target) for s in steps])
        return (centres + BALLS_NOISE * rng.standard_normal(centres.shape)).tolist()

    places = ",".join(f"{x:g}" for x in LEVEL)
    changes = (
        f"plan.balls_m=[{places}]",
        "plan.axis_m=[0.0, 0.0, 0.06]",
        "plan.measure=centre",
        f"solver.sigma_centre_m={BALLS_NOISE}",
        "solver.error_motion_std_m=3.0e-6",
        "solver.tilt_std_arcsec=3.0",
    )
    return measured("table_balls_demo.yaml", changes, values)


def polygon(ecc, rng, *, shifts=(0.0, -30.0, -150.0), added=0.0, noise=POLYGON_NOISE):
    """Return readings of a table with ``ecc`` (12,) rad; ``added`` (12,) is what it reads more."""
    faces, zeros = 3.0 * ARCSEC * rng.standard_normal(12), 1e-5 * rng.standard_normal(len(shifts))
    table = ecc + added

    def values(steps):
        k = np.array([s.table_position for s in steps])
        setting = np.array([s.station for s in steps])
        face = np.round(k - np.array(shifts)[setting] / 30.0).astype(int) % 12
        read = table[k % 12] - faces[face] + zeros[setting]
        read = read + noise * rng.standard_normal(len(k))
        return [(x, 0.0, 0.0) for x in read.tolist()]

    changes = (f"plan.shifts_deg={list(shifts)}", f"solver.sigma_arcsec={noise / ARCSEC}")
    return measured("angle_comparison_demo.yaml", changes, values)


def drawn(rng):
    """Return a world with two balls, drawn from what is stated of it."""
    plan = prepare(read_configuration(CONFIG / "table_balls_demo.yaml")).configuration.plan
    plan = replace(plan, balls_m=LEVEL, axis_m=(0.0, 0.0, 0.06), measure="centre")
    solver = prepare(read_configuration(CONFIG / "table_balls_demo.yaml")).configuration.solver
    solver = replace(
        solver, sigma_centre_m=BALLS_NOISE, error_motion_std_m=3e-6, tilt_std_arcsec=3.0
    )
    return World.drawn(plan, rng, solver)


def truth(world):
    """Return the deviations (12,) of a world by component, in the zeros of a combination."""
    return dict(zip(NAMES, world.truth()[0], strict=True))
