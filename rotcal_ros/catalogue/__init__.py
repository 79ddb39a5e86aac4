"""The catalogue of methods: what each brings so that nodes, replay and report need not ask.

A :class:`Method` says how its settings become a plan, how observations become its problem, and
how the problem is solved. :func:`prepare` turns a configuration into a :class:`Calibration`,
which the live solver and the offline replay use alike: equal observations give results that
are equal to the last bit.
"""

from __future__ import annotations

from rotcal_ros.catalogue.ball_plate import BALL_PLATE
from rotcal_ros.catalogue.calibration import Calibration, Method, final_observations
from rotcal_ros.catalogue.plane_mirror import PLANE_MIRROR
from rotcal_ros.catalogue.runs import (
    ATTEMPTS_PER_RUN,
    Continuation,
    continued,
    last_accepted,
    run_of,
)
from rotcal_ros.catalogue.tracer import TRACER_MULTISTATION
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import ConfigurationError

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        TRACER_MULTISTATION,
        BALL_PLATE,
        PLANE_MIRROR,
    )
}

__all__ = [
    "ATTEMPTS_PER_RUN",
    "METHODS",
    "Calibration",
    "Continuation",
    "Method",
    "continued",
    "final_observations",
    "find_method",
    "last_accepted",
    "prepare",
    "run_of",
]


def prepare(configuration: Configuration) -> Calibration:
    """Return the calibration that a configuration describes.

    Raises ConfigurationError for an unknown method, PlanError for an impossible plan.
    """
    method = find_method(configuration)
    return Calibration(
        configuration=configuration,
        method=method,
        plan=method.plan(configuration),
    )


def find_method(configuration: Configuration) -> Method:
    """Return the method of a configuration; ConfigurationError when there is none."""
    method = METHODS.get(configuration.method)
    if method is None:
        raise ConfigurationError(
            f"{configuration.source}: unknown method {configuration.method!r}; "
            f"known: {', '.join(sorted(METHODS))}"
        )
    return method
