"""The names of the front door for type checkers; a test holds them against __init__.py."""

from collections.abc import Callable
from typing import Any

from rotcal_ros import ros as ros
from rotcal_ros.api import ball_plate as ball_plate
from rotcal_ros.api import plane_mirror as plane_mirror
from rotcal_ros.api import tracer as tracer
from rotcal_ros.api import tracer_six as tracer_six
from rotcal_ros.api.compensating import correction as correction
from rotcal_ros.api.compensating import make_table as make_table
from rotcal_ros.api.compensating import write_controller_files as write_controller_files
from rotcal_ros.api.evaluating import check as check
from rotcal_ros.api.evaluating import combine as combine
from rotcal_ros.api.evaluating import compare as compare
from rotcal_ros.api.evaluating import iso230 as iso230
from rotcal_ros.api.evaluating import solve_together as solve_together
from rotcal_ros.api.evaluating import uncertainty as uncertainty
from rotcal_ros.api.evaluating import write_report as write_report
from rotcal_ros.api.measuring import capture_records as capture_records
from rotcal_ros.api.measuring import simulate_observations as simulate_observations
from rotcal_ros.api.measuring import simulate_records as simulate_records
from rotcal_ros.api.measuring import simulated_truth as simulated_truth
from rotcal_ros.api.measuring import solve as solve
from rotcal_ros.api.reading import read_bag as read_bag
from rotcal_ros.api.reading import read_configuration as read_configuration
from rotcal_ros.api.reading import read_result as read_result
from rotcal_ros.api.reading import read_streams as read_streams
from rotcal_ros.api.reading import read_table as read_table
from rotcal_ros.compensation.controllers import controller_names as controller_names
from rotcal_ros.compensation.table import CompensationTable as CompensationTable
from rotcal_ros.evaluation.iso230 import BidirectionalRuns as BidirectionalRuns
from rotcal_ros.foundation.components import unit_of as unit_of
from rotcal_ros.foundation.errors import RotcalError as RotcalError
from rotcal_ros.foundation.observations import Observation as Observation
from rotcal_ros.foundation.observations import PointKind as PointKind
from rotcal_ros.foundation.results import Result as Result
from rotcal_ros.foundation.units import ARCSEC as ARCSEC
from rotcal_ros.foundation.units import DEGREE as DEGREE
from rotcal_ros.foundation.units import MICROMETRE as MICROMETRE
from rotcal_ros.methods.configuration import Configuration as Configuration
from rotcal_ros.methods.method import method_names as method_names
from rotcal_ros.recordings.replay import Recording as Recording

__version__: str
__all__: list[str]
# Of packages beside this one, which may be missing:
plan_plate: Callable[..., Any]
write_certificate: Callable[..., Any]
