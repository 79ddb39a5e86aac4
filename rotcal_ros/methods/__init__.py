"""The methods: what each provides so that nodes, replay and report need not ask.

A :class:`Method` says how its settings become a plan, how streams become observations, and how
these are solved. :func:`prepare` turns a configuration into a :class:`Calibration`, which the live
solver and the offline replay use alike. A name is loaded when it is first asked for: what can be
set is known without loading what makes plans and solves.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rotcal_ros.methods.calibration import (
        Calibration,
        last_accepted,
        prepare,
        prepare_to_measure,
        prepare_whole,
    )
    from rotcal_ros.methods.configuration import (
        Configuration,
        changed,
        parse_configuration,
        read_configuration,
    )
    from rotcal_ros.methods.method import Method, find_method, method_names

__all__ = [
    "Calibration",
    "Configuration",
    "Method",
    "changed",
    "find_method",
    "last_accepted",
    "method_names",
    "parse_configuration",
    "prepare",
    "prepare_to_measure",
    "prepare_whole",
    "read_configuration",
]
_ELSEWHERE: Final = {
    **dict.fromkeys(("Method", "find_method", "method_names"), "method"),
    **dict.fromkeys(
        ("Configuration", "changed", "parse_configuration", "read_configuration"), "configuration"
    ),
}
"""Name -> module, for those that the module ``calibration`` does not define."""


def __getattr__(name: str) -> Any:
    """Load the module of a name."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_ELSEWHERE.get(name, 'calibration')}"), name)
