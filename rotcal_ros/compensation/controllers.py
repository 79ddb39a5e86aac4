"""All controllers that are installed, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rotcal_ros.compensation.controller import Controller
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import load


def controller_names() -> tuple[str, ...]:
    """Return the names of all controllers that are installed.

    >>> import rotcal_ros as rc
    >>> "linuxcnc" in rc.controller_names()
    True
    """
    return plugins.names(plugins.CONTROLLERS)


def make_controller(
    name: str, values: Mapping[str, Any] | None = None, where: str | None = None
) -> Controller:
    """Return the controller ``name`` with the settings ``values``.

    Raises ConfigurationError, with the place (``where``, else the name) and the nearest name,
    for what it does not know or what is out of range.
    """
    found = plugins.load(plugins.CONTROLLERS, name, "controller")
    if not (isinstance(found, type) and issubclass(found, Controller)):
        raise ConfigurationError(
            f"the controller {name!r} is {found!r}, no subclass of Controller"
        )
    return load(found, values, where or name)
