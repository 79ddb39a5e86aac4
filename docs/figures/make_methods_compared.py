"""Draw methods_compared.svg: one simulated table by four methods; print how often they agree.

usage: make_methods_compared.py [RUNS]
"""

import sys
from pathlib import Path

import numpy as np

from rotcal_ros.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.evaluation.compare import Comparison, compare_all
from rotcal_ros.methods import ball_plate, plane_mirror, tracer, tracer_six
from rotcal_ros.report.comparison import curves_and_errors

sys.path.insert(0, str(Path(__file__).parents[2] / "test" / "evaluation"))
import one_table

BALLS = (0, 3, 4, 9, 14, 20)


def measure(seed: int) -> dict[str, MeasuredCurve]:
    """Draw a table and instruments, measure with every method and return the curves."""
    rng = np.random.default_rng(seed)
    table = one_table.table_deviations(24, rng)
    results = {
        "laser tracer": tracer.solve(one_table.by_tracer(table, rng, every=2)),
        "ball plate": ball_plate.solve(one_table.by_ball_plate(table, rng, BALLS)),
        "plane mirror": plane_mirror.solve(one_table.by_mirror(table, rng)),
        "tracer at three places": tracer_six.solve(
            one_table.by_tracer_at_places(table, np.random.default_rng([seed, 1]), every=2)
        ),
    }
    return {name: measured_curve(result) for name, result in results.items()}


def rates(runs: int) -> None:
    """Print for every pair how many |E_n| are within 1, chi-square / dof and the verdicts."""
    found: dict[tuple[str, str], list[Comparison]] = {}
    for seed in range(1, runs + 1):
        for pair, comparison in compare_all(measure(seed)).items():
            found.setdefault(pair, []).append(comparison)
    for (a, b), many in found.items():
        within = np.mean(np.abs(np.concatenate([c.normalised_error for c in many])) <= 1.0)
        ratio = np.mean([c.chi2 / c.dof for c in many])
        agree = np.mean([c.agree for c in many])
        sys.stdout.write(
            f"{a} - {b}: {100 * within:.1f} % within 1, chi2/dof {ratio:.2f}, "
            f"{100 * agree:.1f} % agree\n"
        )


def main() -> None:
    """Draw the first run, then print the rates of as many as asked for."""
    curves = measure(1)
    figure = curves_and_errors(curves, compare_all(curves), "ECC")
    Path(__file__).with_name("methods_compared.svg").write_text(figure, encoding="utf-8")
    if len(sys.argv) > 1:
        rates(int(sys.argv[1]))


if __name__ == "__main__":
    main()
