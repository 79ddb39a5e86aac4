"""Where eight balls should stand on a 10 degree grid, and what they promise."""

import numpy as np

import rotcal_ros as rc

GRID, BALLS, RADIUS, SIGMA = 36, 8, 0.185, 0.1e-6

layout = rc.plan_plate(GRID, BALLS, min_gap=2)
predicted = layout.predicted_std(SIGMA, RADIUS)
print(f"ball steps: {layout.steps}, {'proven optimal' if layout.optimal else 'best found'}")
for name, std in predicted.items():
    unit, text = rc.unit_of(name)
    print(f"{name}: {std / unit:.3f} {text}")

# The same from the solver: exact centres with this noise stated.
table, row = np.divmod(np.arange(GRID * BALLS), BALLS)
ball = np.array(layout.steps)[row]
place = 2 * np.pi * (table + ball) / GRID
centres = RADIUS * np.column_stack([np.cos(place), np.sin(place), np.zeros_like(place)])
result = rc.ball_plate.solve(
    rc.ball_plate.Problem(GRID, RADIUS, table, ball, centres, sigma=SIGMA)
)
ratio = np.sqrt(np.mean(result.std["ECC"] ** 2)) / predicted["ECC"]
print(f"solver / prediction: {ratio:.6f}")
