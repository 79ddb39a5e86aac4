"""The centre of a ball: from its touch points, or as the machine computed it; and its checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import dist

import numpy as np

from rotcal_ros.capture.decisions import mean_point
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.window import ReducedWindow
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import ProbeSample
from rotcal_ros.foundation.units import MICROMETRE, MILLIMETRE
from rotcal_ros.geometry.sphere import Spheres, fit_spheres
from rotcal_ros.planning.plan import Step

LOWER = 0.1
"""Part of the radius by which touch points on the upper half cannot lie below the centre."""
_DOUBT = 5.0
"""Standard deviations by which a fitted radius may differ from the stated one."""


def touched_centre(
    samples: Sequence[ProbeSample], step: Step, settings: CaptureSettings
) -> ReducedWindow:
    """Return the centre (m) of the sphere through touch points, where the plan has the ball."""
    return reject_if_misplaced(fitted_centre(samples, step, settings), step, settings)


def reported_centre(
    samples: Sequence[ProbeSample], step: Step, settings: CaptureSettings
) -> ReducedWindow:
    """Return the centre (m) that the machine computed, where the plan has the ball."""
    return reject_if_misplaced(mean_point(samples, step, settings), step, settings)


def fitted_centre(
    samples: Sequence[ProbeSample], step: Step, settings: CaptureSettings
) -> ReducedWindow:
    """Return the centre (m) of the sphere through touch points, or why there is none.

    The ball's and the tip's radius are known; points that stand out of the others (dirt) are
    left out. ``scatter`` is the standard deviation of a touch point, ``std`` that of the centre.
    """
    tips = sorted({sample.tip_radius for sample in samples})
    if len(tips) > 1 or not tips[0] >= 0.0:
        return ReducedWindow(
            reason=phrase("the touch points name the tip radii {0} m; expected one", tips)
        )
    points = np.array([[sample.position for sample in samples]])
    spheres = fit_spheres(points, radius=0.5 * step.ball_diameter, tip_radius=tips[0])
    n_used = int(spheres.used.sum())
    if spheres.reason[0]:
        return ReducedWindow(n_used=n_used, reason=spheres.reason[0])
    x, y, z = spheres.centres[0].tolist()
    std_x, std_y, std_z = np.sqrt(np.diag(spheres.covariance[0])).tolist()
    return ReducedWindow(
        mean=(x, y, z),
        std=(std_x, std_y, std_z),
        scatter=(float(spheres.std[0]),) * 3,
        n_used=n_used,
        reason=_doubt(points, spheres, step, tips[0], settings),
    )


def reject_if_misplaced(
    reduced: ReducedWindow, step: Step, settings: CaptureSettings
) -> ReducedWindow:
    """Return ``reduced``, rejected when the ball is not where the plan has it."""
    if reduced.reason:
        return reduced
    away = dist(reduced.mean, step.position)
    if away <= settings.ball_tolerance_m:
        return reduced
    reason = phrase(
        "the ball of step {0} is {1:.4g} mm from its planned place {2} m, found {3}, allowed "
        "{4:g} mm: another ball, a plate mounted shifted or upside down, or millimetres instead "
        "of metres", step.target, away / MILLIMETRE, step.position, reduced.mean,
        settings.ball_tolerance_m / MILLIMETRE
    )  # fmt: skip
    return replace(reduced, reason=reason)


def _doubt(
    points: Floats, spheres: Spheres, step: Step, tip_radius: float, settings: CaptureSettings
) -> Phrase | None:
    """Say what speaks against a fitted ball, if anything does."""
    radius = 0.5 * step.ball_diameter
    free = fit_spheres(points, radius=None, tip_radius=tip_radius, used=spheres.used, reject=False)
    found, doubt = float(free.radii[0]), _DOUBT * float(free.radius_std[0])
    if abs(found - radius) > max(settings.max_form_m, doubt):
        return phrase(
            "the touch points lie on a ball of diameter {0:.4f} mm with the tip radius {1:.4f} "
            "mm, the plate says {2:.4f} mm: check ball diameter and tip radius",
            2.0 * found / MILLIMETRE, tip_radius / MILLIMETRE, 2.0 * radius / MILLIMETRE
        )  # fmt: skip
    below = float(points[0, spheres.used[0], 2].mean() - spheres.centres[0, 2])
    if below < -LOWER * (radius + tip_radius):
        return phrase(
            "the touch points lie below the centre of the ball: a plate on a table is "
            "touched from above, so z of the probe has the wrong sign, or points down"
        )
    count, n_used = points.shape[1], int(spheres.used.sum())
    if n_used < settings.min_used_share * count:
        return phrase(
            "only {0} of {1} touch points fit the ball, expected at least {2:.0%}: clean ball "
            "and tip", n_used, count, settings.min_used_share
        )  # fmt: skip
    form = float(spheres.form_deviation[0])
    if form > settings.max_form_m:
        return phrase(
            "form deviation {0:.3g} um of the touch points, allowed {1:g} um: dirt, or something "
            "moved", form / MICROMETRE, settings.max_form_m / MICROMETRE
        )  # fmt: skip
    return None
