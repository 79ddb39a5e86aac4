"""A tracer at three places of the table: all six deviations from lengths, and what moved."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

configuration = rc.read_configuration(DATA / "tracer_six.yaml")
result = rc.read_table(DATA / "three_places" / "lengths.csv", configuration).solve()
truth = rc.simulated_truth(configuration)

print(f"{result.n_observations} lengths, verdict: {result.verdict_line}")
for name, curve in result.deviations.items():
    unit, word = (rc.ARCSEC, "arcsec") if name in ("EAC", "EBC", "ECC") else (rc.MICROMETRE, "um")
    std = result.std[name]
    print(
        f"{name}: {curve.min() / unit:6.2f} to {curve.max() / unit:5.2f} {word}, "
        f"largest U (k = 2) {2 * std.max() / unit:.2f}, rms error / stated standard uncertainty: "
        f"{np.sqrt(np.mean(((curve - truth[name]) / std) ** 2)):.2f}"
    )

for segment in result.details["segments"]:
    if "step" in segment:  # the beam broke at this place: its counter began anew
        step, std = segment["step"] / rc.MICROMETRE, segment["step_std"] / rc.MICROMETRE
        print(f"place {segment['place_id']}: the zero stepped by {step:.2f} um (std {std:.2f})")
