"""A recorded bag is captured and solved again without ROS, then its report is written."""

from pathlib import Path

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

recording = rc.read_bag(DATA / "ball_plate_bag")
for warning in recording.warnings():
    print("warning:", warning)
accepted = [o for o in recording.observations if o.accepted]
print(f"{len(accepted)} of {len(recording.observations)} observations accepted")
result = recording.solve()
print(f"{recording.calibration.method.title}: verdict {result.verdict_line}")
Path("out").mkdir(exist_ok=True)
print("report:", rc.write_report(recording, "out/report.html"))

truth = rc.simulated_truth(rc.read_configuration(DATA / "ball_plate.yaml"))["ECC"]
largest = abs(result.deviations["ECC"] - truth).max() / rc.ARCSEC
print(f"largest error against the truth: {largest:.3f} arcsec")
