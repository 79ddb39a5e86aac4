"""My own solver on the raw streams of a bag: spheres by lstsq, then the three-rosette model."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"
configuration = rc.read_configuration(DATA / "ball_plate.yaml")
grid = configuration.plan.plate.grid
radius = configuration.plan.plate.circle_radius_m


def centre_of(points):
    """Fit a sphere to probe points (k, 3): |p|^2 = 2 c.p + (r^2 - |c|^2) is linear."""
    origin = points.mean(axis=0)
    near = points - origin
    design = np.column_stack([2 * near, np.ones(len(near))])
    return np.linalg.lstsq(design, np.sum(near**2, axis=1), rcond=None)[0][:3] + origin


points = rc.read_streams(DATA / "ball_plate_bag").points
points = points[points["kind"] == rc.PointKind.SURFACE]
print(f"{len(points)} raw probe points")

# One centre per step; where the table stood follows from the place of the ball.
rows = []
for step in np.unique(points["step"]):
    touched = points[points["step"] == step]
    x, y, _ = centre = centre_of(touched["position"])
    cmm = round(np.arctan2(y, x) / (2 * np.pi / grid)) % grid
    ball = touched["target"][0]
    place = 2 * np.pi * cmm / grid
    tangential = (centre[1] * np.cos(place) - centre[0] * np.sin(place)) / radius
    rows.append(((cmm - ball) % grid, ball, cmm, tangential))
table, ball, cmm = (np.array(column) for column in list(zip(*rows, strict=True))[:3])
tangential = np.array([row[3] for row in rows])

# tangential = ECC of the table + error of the ball's place + error of the CMM there
unit = np.eye(grid)
design = np.column_stack([unit[table], unit[ball], unit[cmm]])
ecc = np.linalg.lstsq(design, tangential, rcond=None)[0][:grid]
ecc -= ecc.mean()

truth = rc.simulated_truth(configuration)["ECC"]
print("angle/deg  own/arcsec  truth/arcsec")
for index in range(grid):
    print(f"{360 * index / grid:9.0f} {ecc[index] / rc.ARCSEC:11.2f} "
          f"{truth[index] / rc.ARCSEC:13.2f}")  # fmt: skip
print(f"largest error against the truth: {abs(ecc - truth).max() / rc.ARCSEC:.2f} arcsec")
