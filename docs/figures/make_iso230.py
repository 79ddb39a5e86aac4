"""Draw iso230.svg: the diagrams of ISO 230-2 for the hand-checkable vector of the tests."""

from pathlib import Path

import numpy as np

from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.report.iso230 import draw_runs

STEPS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
UP = ([0, 3, 5, 2, -1, -4, -3, -1], [0.2, 0.2, 0.4, 0.2, 0.2, 0.3, 0.2, 0.2])
DOWN = ([-2, 0, 2, 0, -4, -6, -6, -2], [0.2, 0.3, 0.2, 0.2, 0.5, 0.2, 0.2, 0.2])


def main() -> None:
    """Evaluate and draw."""
    forward, reverse = (
        (np.array(mean)[:, None] + np.outer(spread, STEPS)) * ARCSEC for mean, spread in (UP, DOWN)
    )
    runs = BidirectionalRuns(np.arange(8) * 45.0 * DEGREE, forward, reverse)
    figure = draw_runs(runs, iso230(runs))
    Path(__file__).with_name("iso230.svg").write_text(figure, encoding="utf-8")


if __name__ == "__main__":
    main()
