"""Draw the deviations of runs: ``python docs/figures/make_run_figures.py FOLDER ...``.

Every folder is the output of a ``rotcal run``; the figure's name follows the method.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.figures import curves as figures

FIGURES = Path(__file__).parent
NAMES = {"tracer_multistation": "demo_deviations"}
"""Method -> name of the figure of its demonstration."""


def draw_run(folder: Path) -> Path:
    """Draw the deviations of one run with their truth and return the file."""
    result = Result.from_dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))
    truth_file = folder / "truth.json"
    truth = json.loads(truth_file.read_text(encoding="utf-8")) if truth_file.exists() else None
    target = FIGURES / f"{NAMES.get(result.method, result.method)}.svg"
    target.write_text(figures.deviations(result, truth), encoding="utf-8")
    return target


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(draw_run(Path(argument)))  # noqa: T201
