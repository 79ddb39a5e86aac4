"""Make the sample data of the examples from the simulated cell: ``python make_data.py FOLDER``.

One table with a known error is measured by all four methods. The tables are the same whenever
this runs; the last digits of result files may differ from one processor to the next.
"""

import sys
from pathlib import Path

import numpy as np
from make_bag import write_bag

import rotcal_ros as rc

CONFIG = Path(__file__).parents[2] / "config"
ECC = "{amplitudes_arcsec: [4.0, 1.5, 0.6, 0.3], phases_deg: [20.0, -75.0, 140.0, 60.0]}"
BALLS = "[0, 1, 3, 5, 8, 9]"
CHANGES = {
    "tracer": (
        "simulation.probe.repeatability_um=0.1",
        "plan.table_start_deg=0.0",
        "plan.table_positions=12",
        "plan.box_centre_m=[0.0, 0.0, 0.6]",
        "plan.box_size_m=[0.9, 0.9, 0.4]",
        "plan.box_points=[4, 3, 2]",
        "capture.window_samples=10",
        "solver.length_std_m=1.2e-7",
        "simulation.tracer.dead_distance_m=0.4",
        "simulation.faults.blocked_targets=[]",
    ),
    "tracer_six": (
        "plan.box_points=[3, 3, 2]",
        "plan.closes=true",
        "capture.window_samples=10",
        "solver.length_std_m=3.4e-7",
        "simulation.faults.break_probability=3.0e-5",
        "simulation.faults.break_shift_um=50.0",
    ),
    "ball_plate": (
        "plan.plate={grid: 12, ball_steps: " + BALLS + ", circle_radius_m: 0.185, "
        "ball_diameter_m: 0.025}",
        "plan.points_per_ball=7",
        "solver.sigma_centre_m=1.0e-7",
        "simulation.plate.grid=12",
        f"simulation.plate.ball_steps={BALLS}",
        "simulation.touch_probe.points_per_ball=7",
        "simulation.touch_probe.dirt_probability=0.0",
        "simulation.table.feedback_rate_hz=2.0",
    ),
    "plane_mirror": (
        "plan.table_positions=9",
        "plan.table_step_deg=15.0",
        "plan.reflectors=2",
        "simulation.tracker.station_azimuths_deg=[22.5, 67.5, 105.0]",
    ),
}


def write_table(path, header, rows):
    """Write rows with lengths to 0.1 nm."""
    lines = [header] + [
        ",".join(f"{cell:.10f}" if isinstance(cell, float) else str(cell) for cell in row)
        for row in rows
    ]
    path.write_text("\n".join(lines) + "\n")


def measured(method, folder):
    """Write the configuration of a method and return it with what the cell observes."""
    changes = (*CHANGES[method], f"simulation.table.ecc={ECC}")
    base = "tracer_paper" if method == "tracer" else f"{method}_demo"
    text = rc.read_configuration(CONFIG / f"{base}.yaml", *changes).text
    path = folder / f"{method}.yaml"
    path.write_text(f"# The sample data of this folder: {method}, simulated.\n{text}")
    configuration = rc.read_configuration(path)
    return configuration, rc.simulate_observations(configuration)


def tracer(folder):
    """Lengths by table position and target, and where the targets are."""
    configuration, observations = measured("tracer", folder)
    rows = [(o.table_position, o.target, *o.mean) for o in observations if o.accepted]
    write_table(folder / "lengths.csv", "position,target,length_m", rows)
    write_targets(folder / "targets.csv", observations)
    (folder / "result_tracer.json").write_text(rc.solve(observations, configuration).to_json())


def write_targets(path, observations):
    """Write where the targets are, to 0.1 mm."""
    targets = sorted({(o.target, *o.probe_position) for o in observations})
    nominal = {number: place for number, *place in targets}
    rows = [(number, *(round(x, 4) for x in place)) for number, place in nominal.items()]
    write_table(path, "target,x_m,y_m,z_m", rows)


def tracer_six(folder):
    """Lengths by place, table position and target; a broken beam begins another segment."""
    _configuration, observations = measured("tracer_six", folder)
    rows = [
        (o.station, o.table_position, o.target, *o.mean, o.segment)
        for o in observations
        if o.accepted
    ]
    tables = folder / "three_places"
    tables.mkdir(exist_ok=True)
    write_table(tables / "lengths.csv", "place,position,target,length_m,segment", rows)
    write_targets(tables / "targets.csv", observations)


def ball_plate(folder):
    """Ball centres by table position and ball step, and the bag with the raw streams."""
    configuration, observations = measured("ball_plate", folder)
    rows = [(o.table_position, o.target, *o.mean) for o in observations if o.accepted]
    write_table(folder / "balls.csv", "position,ball_step,x_m,y_m,z_m", rows)
    (folder / "result_ball_plate.json").write_text(rc.solve(observations, configuration).to_json())
    write_bag(folder / "ball_plate_bag", configuration)


def plane_mirror(folder):
    """Tracker points, in the frame of each tracker station."""
    _configuration, observations = measured("plane_mirror", folder)
    rows = [
        ("" if o.kind == rc.PointKind.NEST else o.table_position, o.station, o.kind.name.lower(),
         o.target, *o.mean)
        for o in observations
    ]  # fmt: skip
    write_table(folder / "tracker.csv", "position,tracker_station,kind,nest,x_m,y_m,z_m", rows)


def runs(folder):
    """Five runs up and down at 12 angles: 1.5 arcsec of reversal, 0.2 of repeatability."""
    rng, angles = np.random.default_rng(7), np.arange(0, 360, 30)
    rows = ["angle_deg,run,direction,deviation_arcsec"]
    for run in range(1, 6):
        for direction, reversal in (("up", 0.0), ("down", 1.5)):
            mean = 3.0 * np.sin(np.radians(angles)) + reversal
            values = mean + rng.normal(0.0, 0.2, len(angles))
            rows += [f"{a},{run},{direction},{v:.3f}" for a, v in zip(angles, values, strict=True)]
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    for make in (tracer, tracer_six, ball_plate, plane_mirror, runs):
        make(Path(sys.argv[1]))
