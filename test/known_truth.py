"""How a result stands to the injected truth: E_n of every angle and component."""

import numpy as np

from rotcal_ros.methods.simulation.table import true_deviations


def normalized_errors(calibration, result):
    """Return E_n with k = 2 where it is defined; the injected truth has no uncertainty."""
    injected = true_deviations(calibration.configuration.simulation.table, result.angles)
    truth = calibration.method.gauge(result.angles, injected)
    found = np.concatenate(
        [(result.deviations[n] - truth[n]) / (2.0 * result.std[n]) for n in result.components]
    )
    return found[np.isfinite(found)]
