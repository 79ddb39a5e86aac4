"""A laser tracker and a plane mirror: from tracker points to ECC, and the ways compared."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

configuration = rc.read_configuration(DATA / "plane_mirror.yaml")
truth = rc.simulated_truth(configuration)["ECC"]
for way in ("joint", "stitching", "registration"):
    setup = rc.read_configuration(DATA / "plane_mirror.yaml", f"solver.way={way}")
    result = rc.read_table(DATA / "tracker.csv", setup).solve()
    error = result.deviations["ECC"] - truth
    std = result.std["ECC"].max()
    print(
        f"{way:12s} verdict {result.verdict_line}; "
        f"largest U (k = 2) {2 * std / rc.ARCSEC:.2f} arcsec, "
        f"rms error {np.sqrt(np.mean(error**2)) / rc.ARCSEC:.2f} arcsec"
    )
