"""Reading what was measured: bags, tables, results, configurations."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import Configuration, changed, read_setup
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings import result_sources
from rotcal_ros.recordings.replay import Recording, Source, read_recording
from rotcal_ros.recordings.topics import Topics

Name = str | PathLike[str]
"""A path as people give it."""


def read_configuration(path: Name, *changes: str) -> Configuration:
    """Return the configuration in the YAML file ``path``, with ``group.name=value`` changes.

    It has one typed object for each group of settings; units stand in the names (``_deg``,
    ``_m``). Raises ConfigurationError, with the nearest name, for what is misspelt or impossible.

    >>> import rotcal_ros as rc
    >>> configuration = rc.read_configuration(
    ...     "examples/data/ball_plate.yaml", "plan.points_per_ball=9"
    ... )
    >>> configuration.method.name, configuration.plan.points_per_ball
    ('ball_plate', 9)
    """
    return changed(read_setup(Path(path)), changes)


def read_bag(
    path: Name,
    source: Source = "streams",
    *,
    configuration: Configuration | None = None,
    namespace: str = "",
) -> Recording:
    """Read a recorded bag: a folder, an .mcap or a .db3 file, be it cut off or damaged.

    ``source`` "streams" captures the raw streams again, "observations" takes those that were
    captured live. ``configuration`` takes the place of the one in the bag; ``namespace`` chooses
    one of several cells. The recording has ``observations`` (m), ``calibration`` (configuration
    and plan), ``solve()``, which gives the result as live, to the last bit, and ``warnings()``.
    Raises BagError when there is no bag or it holds no configuration.

    >>> import rotcal_ros as rc
    >>> recording = rc.read_bag("examples/data/ball_plate_bag")
    >>> len(recording.observations), recording.warnings()
    (78, ())
    >>> recording.solve().verdict
    'ok'
    """
    return read_recording(
        Path(path),
        source,
        configuration=configuration,
        topics=Topics.of(configuration, namespace),
    )


def read_table(
    path: Name, setup: Configuration | Name, targets: Name | None = None
) -> Measurements:
    """Read a plain table (.csv) of another program: lengths, ball centres, or tracker points.

    ``setup`` is a configuration or its file. The columns are ``position,target,length_m``,
    ``position,ball_step,x_m,y_m,z_m`` or ``position,tracker_station,kind,nest,x_m,y_m,z_m``;
    metres, positions count from 0. ``targets`` (``target,x_m,y_m,z_m``) is looked for beside a
    table of lengths as targets.csv. ``solve()`` of what is returned gives the result. Raises
    BagError when a file cannot be read, DataError with file and row, ConfigurationError.

    >>> import rotcal_ros as rc
    >>> table = rc.read_table("examples/data/lengths.csv", "examples/data/tracer.yaml")
    >>> table.solve().method
    'tracer_multistation'
    """
    configuration = setup if isinstance(setup, Configuration) else read_setup(Path(setup))
    places = None if targets is None else Path(targets)
    return read_measurements(Path(path), configuration, places)


def read_result(path: Name) -> Result:
    """Return the result in a result.json, or that of a bag, which is solved.

    ``deviations``, ``std`` (k = 1) and ``covariance`` map EXC, EYC, EZC (m), EAC, EBC, ECC (rad),
    as far as the method finds them, to arrays (n,) and (n, n) at ``angles`` (n,) rad; deviation =
    actual - commanded. Raises BagError and DataError when there is no such result.

    >>> import rotcal_ros as rc
    >>> result = rc.read_result("examples/data/result_ball_plate.json")
    >>> result.deviations["ECC"].shape
    (12,)
    """
    return result_sources.read_source(Path(path)).result
