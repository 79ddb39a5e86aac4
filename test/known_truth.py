"""How a result stands to the injected truth."""

import numpy as np
from chances import ODDS_BY_CLOCK, chance

from rotcal_ros.methods.simulation.table import true_deviations


def require_injected_truth(calibration, result):
    """Assert that a live result is true; the truth that was injected has no uncertainty."""
    injected = true_deviations(calibration.configuration.simulation.table, result.angles)
    require_truth(result, calibration.method.gauge(result.angles, injected))


def require_truth(result, truth):
    """Assert that a live result is as far from the ``truth`` as its covariance says, or nearer."""
    for name in result.components:
        error = result.deviations[name] - truth[name]
        assert np.abs(error).max() <= 5.5 * result.std[name].max(), (name, error)
        assert chance(error, result.covariance[name]) > ODDS_BY_CLOCK, (name, error)
