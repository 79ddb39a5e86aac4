"""U of axis and ECC, and minutes, for one to three balls: the table of docs/table_balls.md."""

import numpy as np

from rotcal_ros.adjust.engine import predicted
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.table_balls.method import METHOD, model
from rotcal_ros.planning.readings import Readings

HEIGHTS = ([0.08], [0.08, 0.08], [0.04, 0.12], [0.04, 0.08, 0.12])
for heights in HEIGHTS:
    turns = np.arange(len(heights)) * 2.0 * np.pi / len(heights)
    balls = [[0.15 * np.cos(t), 0.15 * np.sin(t), h] for t, h in zip(turns, heights, strict=True)]
    setup = parse_configuration(
        f"method: table_balls\nballs_m: {[list(map(float, b)) for b in balls]}\n"
        "axis_m: [0.0, 0.0, 0.08]\n"
    )
    plan = METHOD.plan(setup)
    read = Readings.of([step.observed(step.position) for step in plan.steps])
    std = 2.0 * predicted(model(setup, read)).std
    ecc = std[:-4].reshape(-1, 12)[-1].max() / ARCSEC
    place, lean = std[-4] / MICROMETRE, std[-2] / ARCSEC
    minutes = (len(plan.steps) * (5 * 2.0 + 3.0) + 25 * 2.5) / 60
    print(
        f"{len(heights)} at {heights}: XOC {place:.2f} um, AOC {lean:.1f} arcsec, "
        f"ECC {ecc:.1f} arcsec, {minutes:.1f} min"
    )
