"""From records to observations to a result, whether the records are measured or simulated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rotcal_ros.capture.capture import Record
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.observations import Command, Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.simulated_run import simulated_run, visible_truth


def capture_records(
    records: Iterable[Record], configuration: Configuration
) -> tuple[Observation, ...]:
    """Turn records of the instruments into observations, as the capture node does live.

    ``records`` are those of ``rotcal_ros.foundation.observations`` (TracerSample, TableSample,
    ProbeSample, TemperatureSample, PressureSample, HumiditySample), ns, m, rad, degC and Pa, in
    the order in which they came. There is one observation per attempt at a step of the plan; a
    rejected one says why. Raises PlanError and ConfigurationError for a configuration that cannot
    work.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> observations = rc.capture_records(rc.simulate_records(configuration), configuration)
    >>> observations == rc.simulate_observations(configuration)
    True
    """
    capture = prepare(configuration).capture()
    return tuple(found for record in records for found in capture.feed(record))


def simulate_records(configuration: Configuration) -> Iterator[Record]:
    """Yield the records of the simulated cell's instruments, step by step, without ROS.

    The cell is that of the group ``simulation``: its seed makes the same records again. Units as
    in :func:`capture_records`; errors as there, and ConfigurationError without this group.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> type(next(rc.simulate_records(configuration))).__name__
    'TemperatureSample'
    """
    _require_simulation(configuration)
    run = simulated_run(prepare(configuration))
    return (event.what for event in run if not isinstance(event.what, Command))


def simulate_observations(configuration: Configuration) -> tuple[Observation, ...]:
    """Return the observations of one simulated attempt at every step, without ROS.

    ``mean`` and ``std`` are metres, ``table_angle`` radians; errors as in
    :func:`simulate_records`.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> observations = rc.simulate_observations(configuration)
    >>> len(observations), observations[0].accepted
    (78, True)
    """
    _require_simulation(configuration)
    return tuple(o for event in simulated_run(prepare(configuration)) for o in event.observed)


def simulated_truth(configuration: Configuration) -> dict[str, Floats]:
    """Return the deviations that the simulation injects, as far as the method can see them.

    Component -> (n,) in m or rad at the table angles of the plan; deviation = actual -
    commanded. Compare them with ``Result.deviations``. Errors as in :func:`simulate_records`.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/tracer.yaml")
    >>> float(rc.simulated_truth(configuration)["ECC"][0])  # counted from the first angle
    0.0
    """
    _require_simulation(configuration)
    return visible_truth(prepare(configuration))


def solve(observations: Iterable[Observation], configuration: Configuration) -> Result:
    """Return the deviations that the observations show, by the method of the configuration.

    The last accepted attempt at every step counts; the order of the observations does not. For
    the result see ``read_result``: SI, deviation = actual - commanded. Raises DataError for data
    that are contradictory or too few, ObservabilityError if the geometry cannot determine them,
    ConfigurationError for what are no observations or no configuration.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration("examples/data/ball_plate.yaml")
    >>> result = rc.solve(rc.simulate_observations(configuration), configuration)
    >>> sorted(result.deviations)
    ['EAC', 'EBC', 'ECC', 'EXC', 'EYC', 'EZC']
    """
    if not isinstance(configuration, Configuration):
        raise ConfigurationError(
            f"configuration is a {type(configuration).__name__}: expected what "
            "rc.read_configuration returns"
        )
    seen = list(observations) if isinstance(observations, Iterable) else [observations]
    if wrong := [each for each in seen if not isinstance(each, Observation)]:
        raise ConfigurationError(
            f"observations hold a {type(wrong[0]).__name__}: expected those of "
            "rc.capture_records, or give a bag or table to rc.read_bag or rc.read_table"
        )
    if not seen:
        raise DataError(
            f"observations are empty: there is nothing to solve by {configuration.method.name}"
        )
    return prepare(configuration).solve(seen)


def _require_simulation(configuration: Configuration) -> None:
    """Raise ConfigurationError if the result would look like that of a real cell."""
    if not configuration.simulated:
        raise ConfigurationError(
            f"{configuration.source} has no group 'simulation': it describes a real cell; add "
            "the group (it may be empty: simulation: {}) to simulate one"
        )
