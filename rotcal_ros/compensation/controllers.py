"""All controllers by name, and their settings from a plain mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from rotcal_ros import plugins
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.errors import ConfigurationError


def controller_names() -> tuple[str, ...]:
    """Return the names of all controllers that are installed."""
    return plugins.names(plugins.CONTROLLERS)


def controller(name: str) -> Controller:
    """Return the controller ``name``, or raise ConfigurationError with the names there are."""
    found: Controller = plugins.load(plugins.CONTROLLERS, name, "controller")
    return found


def make_settings(name: str, values: Mapping[str, Any]) -> Any:
    """Return the settings of controller ``name`` from ``values``, each of its field's type.

    Raises ConfigurationError for a name that the controller does not know or a wrong type.
    """
    kind = controller(name).settings
    defaults = {field.name: field.default for field in fields(kind)}
    for key, value in values.items():
        if key not in defaults:
            raise ConfigurationError(
                f"{name}: no setting {key!r}, expected one of: {', '.join(defaults) or 'none'}"
            )
        wanted = type(defaults[key])
        if type(value) is not wanted and not (wanted is float and type(value) is int):
            raise ConfigurationError(
                f"{name}: {key} is {value!r}, expected {wanted.__name__} such as {defaults[key]!r}"
            )
    return kind(**values)
