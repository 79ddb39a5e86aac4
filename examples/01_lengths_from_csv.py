"""My lengths are in a CSV: a laser tracer's lengths and targets become ECC with uncertainty."""

from pathlib import Path

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

table = rc.read_table(DATA / "lengths.csv", DATA / "tracer.yaml")  # finds targets.csv beside it
result = table.solve()
print(f"{result.n_observations} lengths, verdict {result.verdict_line}")
print("angle/deg  ECC/arcsec  U/arcsec (k = 2)")
for angle, deviation, std in zip(
    result.angles, result.deviations["ECC"], result.std["ECC"], strict=True
):
    print(f"{angle / rc.DEGREE:9.1f} {deviation / rc.ARCSEC:11.2f} {2 * std / rc.ARCSEC:9.2f}")

truth = rc.simulated_truth(rc.read_configuration(DATA / "tracer.yaml"))["ECC"]
largest = abs(result.deviations["ECC"] - truth).max() / rc.ARCSEC
print(f"largest error against the truth: {largest:.2f} arcsec")
