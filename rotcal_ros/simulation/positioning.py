"""The true positioning of the simulated table, as an instrument without error would see it."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.simulation.settings import SimulationSettings
from rotcal_ros.simulation.table import correction, deviations


def true_runs(settings: SimulationSettings, targets: Floats, runs: int) -> tuple[Floats, Floats]:
    """Return the true deviations (m, runs) rad at ``targets`` (m,), forward and reverse.

    Deviations, control, backlash and the spread from one arrival to the next are those of the
    settings; the spread is drawn with the settings' seed.
    """
    table = settings.table
    random = np.random.default_rng(settings.seed)
    both = []
    for approach, backlash in ((Approach.POSITIVE, 0.0), (Approach.NEGATIVE, 1.0)):
        corrected = correction(table, targets, approach)
        fixed = corrected + deviations(table, targets + corrected)["ECC"]
        fixed = fixed + backlash * table.backlash_arcsec * ARCSEC
        spread = table.repeatability_arcsec * ARCSEC * random.normal(size=(len(targets), runs))
        both.append(fixed[:, None] + spread)
    return both[0], both[1]
