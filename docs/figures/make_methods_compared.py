"""Draw methods_compared.svg: one simulated table by four methods; print how often they agree.

usage: make_methods_compared.py [RUNS]
"""

import sys
from pathlib import Path

import numpy as np

from rotcal_ros.evaluation.compare import Comparison, compare_all
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.report.comparison import curves_and_errors

sys.path.insert(0, str(Path(__file__).parents[2] / "test" / "evaluation"))
import one_table

NAMES = {
    "tracer": "laser tracer",
    "plate": "ball plate",
    "mirror": "plane mirror",
    "six": "tracer at three places",
}


def measure(seed: int) -> dict[str, MeasuredCurve]:
    """Draw a table and instruments, measure with every method and return the curves."""
    _, results = one_table.by_every_method(seed)
    return {NAMES[method]: measured_curve(result) for method, result in results.items()}


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
