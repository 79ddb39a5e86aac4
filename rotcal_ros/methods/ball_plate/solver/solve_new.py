from __future__ import annotations
import numpy as np
from dataclasses import replace
from rotcal_ros.adjust.engine import adjust, Adjusted
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.results import Result, Rejection
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.plate import plate_model
from rotcal_ros.methods.ball_plate.solver.screening import screen
from rotcal_ros.methods.ball_plate.solver.separability import common_divisor


def solve(problem):
    whole, rejected = screen(problem)
    groups = common_divisor(whole.grid, whole.balls) if whole.separate_groups else 1
    layout = PlateLayout(whole, groups)
    found = adjust(plate_model(layout))
    m = layout.counts[0]
    order = layout.row
    positions = np.sort(layout.table_positions)
    result = found.result(
        "ball_plate", problem.angles[positions],
        {name: slice(k * m, (k + 1) * m) for k, name in enumerate(COMPONENTS)},
        (whole.position[order], whole.ball_step[order]),
        counts_from="mean", coordinates=3,
        protections=[Protection(e, "estimated", "as ever") for e in ("axis noise","error motion","repeatability","tilt","numbering")] + [Protection(e, "harmless", "as ever") for e in ("refraction","scale","gauge","sign of z")],
    )
    result.details["noise_scale"] = found.diagnosis.noise.factors
    return result
