"""Ball centres from a CMM become all six deviations of the table."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

result = rc.read_table(DATA / "balls.csv", DATA / "ball_plate.yaml").solve()
truth = rc.simulated_truth(rc.read_configuration(DATA / "ball_plate.yaml"))
print(f"{result.n_observations} ball centres, verdict {result.verdict_line}")
ratios = []
for name, deviation in result.deviations.items():
    unit, text = rc.unit_of(name)
    std = result.std[name]
    ratios.append((deviation - truth[name]) / std)
    print(
        f"{name}: {deviation.min() / unit:6.2f} .. {deviation.max() / unit:5.2f} {text:6s} "
        f"U = {2 * std.max() / unit:.2f} {text}"
    )
print(f"rms error / stated standard uncertainty: {np.sqrt(np.mean(np.square(ratios))):.2f}")
