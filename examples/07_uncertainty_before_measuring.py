"""How sure will it be? Two plans compared before anything is measured, by Monte Carlo."""

from pathlib import Path

import numpy as np

import rotcal_ros as rc

DATA = Path(__file__).parent / "data"

for points in ("[3, 2, 2]", "[6, 4, 2]"):
    configuration = rc.read_configuration(DATA / "tracer.yaml", f"plan.box_points={points}")
    spread = rc.uncertainty(configuration, trials=1000, seed=1)
    ecc = spread.components["ECC"]
    print(f"targets {points}: U(ECC) = {2 * ecc.std.max() / rc.ARCSEC:.2f} arcsec (k = 2)")
    print(" ", spread.in_words())
    ratio = np.mean(ecc.std[1:] / ecc.linear_std[1:])
    print(f"  trials / solver: {ratio:.3f}")
