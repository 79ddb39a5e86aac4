"""U of ECC and minutes for some choices of shifts: the table of docs/angle_comparison.md."""

from rotcal_ros.adjust.engine import predicted
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.angle_comparison.model import model_of, readings_of
from rotcal_ros.methods.angle_comparison.settings import (
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)

solver = ComparisonSolverSettings(sigma_arcsec=1.0)
for steps in (0, 1), (0, 1, 5), (0, 1, 3, 7), (0, 1, 2, 4, 7, 9), range(12):
    shifts = tuple(30.0 * step for step in steps)
    plan = ComparisonPlanSettings(table_positions=13, shifts_deg=shifts)
    std = predicted(model_of(plan, solver, readings_of(plan))).std / ARCSEC
    minutes = len(steps) * (13 * 10 + 120) / 60
    print(f"{len(steps):2} shifts: U = {2 * max(std):.2f}, {minutes:.0f} min")
