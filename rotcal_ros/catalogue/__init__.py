"""The catalogue of methods: what each brings so that nodes, replay and report need not ask.

A :class:`Method` says how its settings become a plan, how streams become observations, and how
these are solved. :func:`prepare` turns a configuration into a :class:`Calibration`, which the live
solver and the offline replay use alike.
"""

from rotcal_ros.catalogue.calibration import (
    Calibration,
    final_observations,
    last_accepted,
    prepare,
    prepare_to_measure,
    prepare_whole,
)
from rotcal_ros.catalogue.configuration import (
    Configuration,
    changed,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.catalogue.method import Method, find_method, method_names

__all__ = [
    "Calibration",
    "Configuration",
    "Method",
    "changed",
    "final_observations",
    "find_method",
    "last_accepted",
    "method_names",
    "parse_configuration",
    "prepare",
    "prepare_to_measure",
    "prepare_whole",
    "read_configuration",
]
