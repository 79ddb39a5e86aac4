"""All controllers by name, and their settings from a plain mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final

from rotcal_ros.compensation import (
    fagor,
    fanuc,
    heidenhain,
    linuxcnc,
    plain_csv,
    pmac,
    sinumerik,
    twincat,
)
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.errors import ConfigurationError

CONTROLLERS: Final[Mapping[str, Controller]] = MappingProxyType(
    {
        module.CONTROLLER.name: module.CONTROLLER
        for module in (
            linuxcnc,
            sinumerik,
            fanuc,
            twincat,
            heidenhain,
            fagor,
            pmac,
            plain_csv,
        )
    }
)


def controller(name: str) -> Controller:
    """Return the controller ``name``, or raise ConfigurationError with the names there are."""
    if name not in CONTROLLERS:
        raise ConfigurationError(
            f"controller {name!r} is not known, expected one of: {', '.join(CONTROLLERS)}"
        )
    return CONTROLLERS[name]


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
