"""All installed controllers, by name, with settings as people write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.untrusted import load_yaml

if TYPE_CHECKING:
    from rotcal_ros.compensation.controller import Controller


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

    Raises ConfigurationError, with the place (``where``, else the name) and the nearest name, for
    settings that are unknown or out of range.
    """
    from rotcal_ros.compensation.controller import Controller  # settings are listed without

    found = plugins.load(plugins.CONTROLLERS, name, "controller")
    if not (isinstance(found, type) and issubclass(found, Controller)):
        raise ConfigurationError(
            f"the controller {name!r} is {found!r}, which is not a subclass of Controller"
        )
    return load(found, values, where or name)


def parse_options(texts: Iterable[str]) -> dict[str, Any]:
    """Return ``name=value`` texts as a mapping; values are YAML scalars.

    Raises ConfigurationError for a text of another form and for a name given twice.
    """
    options: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise ConfigurationError(f"controller setting {text!r}: expected NAME=VALUE")
        if name.strip() in options:
            raise ConfigurationError(
                f"controller setting {name.strip()!r} is given twice: leave one out"
            )
        options[name.strip()] = load_yaml(value, f"controller setting {text!r}")
    return options


def parse_revolutions(text: str) -> dict[str, int]:
    """Return the settings of a travel ``FIRST:LAST`` in revolutions; "-1:2" is -360 .. 720 deg.

    For controllers whose tables do not wrap. Raises ConfigurationError for any other text.
    """
    match = re.fullmatch(r"([+-]?\d{1,4}):([+-]?\d{1,4})", text.strip())
    first, last = (int(match[1]), int(match[2])) if match else (0, 0)
    if last <= first:
        raise ConfigurationError(
            f"revolutions {text!r}: expected FIRST:LAST with LAST above FIRST, such as -1:2 for a "
            "travel of -360 .. 720 degrees"
        )
    return {"first_turn": first, "turns": last - first}
