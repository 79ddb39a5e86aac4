"""Find and remove the errors of rotary tables: ``import rotcal_ros as rc``.

The names of ``__all__`` are the interface for Python; docs/api.md lists them, and those that
packages beside this one add. Each is loaded when it is first used, so that the import costs
nothing. Everything is SI, deviation = actual - commanded, angles counter-clockwise about +z; a
result of any method is a ``Result``.
"""

from importlib import import_module

__version__ = "1.0.0"

_NAMES = {
    "api.reading": (
        "read_bag", "read_configuration", "read_result", "read_streams", "read_table",
    ),
    "api.measuring": (
        "capture_records", "simulate_observations", "simulate_records", "simulated_truth", "solve",
    ),
    "api.evaluating": (
        "check", "combine", "compare", "iso230", "solve_together", "uncertainty", "write_report",
    ),
    "api.compensating": ("correction", "make_table", "write_controller_files"),
    "methods.configuration": ("Configuration",),
    "methods.method": ("method_names",),
    "compensation.controllers": ("controller_names",),
    "compensation.table": ("CompensationTable",),
    "foundation.components": ("unit_of",),
    "foundation.errors": ("RotcalError",),
    "evaluation.iso230": ("BidirectionalRuns",),
    "foundation.observations": ("Observation", "PointKind"),
    "recordings.replay": ("Recording",),
    "foundation.results": ("Result",),
    "foundation.units": ("ARCSEC", "DEGREE", "MICROMETRE"),
}  # fmt: skip
"""Module -> the names that it gives."""
_MODULES = {
    "ball_plate": "api.ball_plate",
    "plane_mirror": "api.plane_mirror",
    "ros": "ros",
    "tracer": "api.tracer",
    "tracer_six": "api.tracer_six",
}
"""Name -> the module that it is."""
_PLACES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = sorted([*_PLACES, *_MODULES])


def __getattr__(name):
    """Load a name of the interface; AttributeError says what is missing for it."""
    if name in _PLACES:
        value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    elif name in _MODULES:
        try:
            value = import_module(f"{__name__}.{_MODULES[name]}")
        except ImportError as error:
            raise AttributeError(
                f"{__name__}.{name} needs ROS 2 with rclpy and rotcal_msgs ({error}): source a "
                "workspace that holds them, or use the .venv of the repository"
            ) from error
    elif name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        value = _of_another_package(name)
    globals()[name] = value
    return value


def _of_another_package(name):
    """Return a function that a package beside this one adds; AttributeError: what to install."""
    from rotcal_ros.foundation import plugins
    from rotcal_ros.foundation.errors import ConfigurationError

    if name not in plugins.names(plugins.FUNCTIONS):
        hint = plugins.package_hint(name, plugins.FUNCTIONS)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    try:
        return plugins.load(plugins.FUNCTIONS, name, "function")
    except ConfigurationError as error:
        raise AttributeError(f"{__name__}.{name}: {error}") from error


def __dir__():
    """Return the names of the interface, with those of installed packages, and nothing else."""
    from rotcal_ros.foundation import plugins

    return sorted([*__all__, *plugins.names(plugins.FUNCTIONS)])
