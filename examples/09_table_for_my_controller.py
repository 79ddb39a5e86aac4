"""A compensation table for a controller, and the correction for software of your own."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

result = rc.read_result(DATA / "result_ball_plate.json")
table = rc.make_table(result, axis="C", reference_angle=0.0)
print("controllers:", *rc.controller_names())
for file in rc.write_controller_files(table, "linuxcnc", "out/tables", replaces=True):
    print("written:", file)

command = 45 * rc.DEGREE
print(f"at 45 deg add {rc.correction(table, command) / rc.ARCSEC:.3f} arcsec to the command")

truth = rc.simulated_truth(rc.read_configuration(DATA / "ball_plate.yaml"))["ECC"]
left = truth - truth[0] + rc.correction(table, result.angles)
print(f"before: {np.ptp(truth) / rc.ARCSEC:.2f} arcsec peak to peak")
print(f"left: {np.ptp(left) / rc.ARCSEC:.2f} arcsec peak to peak")
