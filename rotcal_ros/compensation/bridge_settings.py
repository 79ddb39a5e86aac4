"""The settings of the bridge to a controller: group ``bridge`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.compensation.agreement import LARGEST_AGE_DAYS, AcceptedConflicts
from rotcal_ros.compensation.controllers import make_controller, parse_options
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import add_nested_groups, expert, setting

DEFAULT: Final = "csv"
FOLDER: Final = "folder"
"""The transport that needs no settings of its own."""
STORES: Final = {
    name: plugins.load(plugins.STORE_SETTINGS, name, "transport")
    for name in plugins.names(plugins.STORE_SETTINGS)
}
"""The settings of the other transports, by name; each has a ``check()`` of what it needs."""


@add_nested_groups(STORES)
@dataclass(frozen=True)
class BridgeSettings:
    """Which controller gets tables, in which form, and how far they may change it.

    After these settings each transport has a group of its own, under its name.
    Raises ConfigurationError for options that the controller does not take.
    """

    controller: str = setting(
        DEFAULT, doc="kind of controller", choices=plugins.names(plugins.CONTROLLERS)
    )
    options: tuple[str, ...] = setting((), doc="controller settings, each as NAME=VALUE")
    spacing_deg: float = expert(
        0.0,
        minimum=0.0,
        maximum=180.0,
        doc="deg, distance between the rows; 0: the widest that leaves less than a third of U "
        "between them",
    )
    reference_deg: float | None = expert(
        None, doc="deg, angle at which the correction is zero; none: that of the table"
    )
    output_folder: str = setting(
        "", doc="folder for the files of every table; empty: no files are written"
    )
    transport: str = setting(
        FOLDER, doc="how the controller's table is reached", choices=(FOLDER, *STORES)
    )
    controller_folder: str = setting(
        "",
        doc="folder that the controller loads its table from (other transports: one on this "
        "machine for lock, journal and old tables); empty: nothing can be applied",
    )
    secret_file: str = setting(
        "", doc="file with the secret that a request must carry; empty: nothing can be applied"
    )
    busy_command: tuple[str, ...] = expert(
        (),
        doc="command that reports whether the table may be changed: exit code 0: yes, 1: no, with "
        "the reason as output; empty: the controller's own settings decide",
    )
    max_change_arcsec: float = setting(
        60.0,
        minimum=0.0,
        maximum=36_000.0,
        doc="arcsec, largest change of the correction that may be applied",
    )
    accept_unverified: bool = expert(
        False, doc="write files even where something about the controller is not verified"
    )
    accept_simulated: bool = expert(
        False,
        doc="apply tables that no instrument measured; not needed in a configuration with a group "
        "simulation",
    )
    combine: str = expert(
        "as_measured",
        doc="whether a table replaces the one in force or adds to it, if it is not known which "
        "one was in force during the measurement",
        choices=("as_measured", "replace", "add"),
    )
    accept: tuple[str, ...] = expert(
        (),
        doc="contradictions between a table and this cell that are accepted: axis, serial "
        "(number of the item), age (of the measurement)",
    )
    max_age_days: float = expert(
        LARGEST_AGE_DAYS,
        doc="days, largest age of the measurement that a table comes from",
        minimum=1e-3,
    )
    answer_timeout_s: float = expert(
        5.0,
        minimum=0.01,
        maximum=600.0,
        doc="s, time without an answer after which the controller counts as silent",
    )

    def __post_init__(self) -> None:
        self.accepted  # noqa: B018  raises for a misspelt word
        if self.transport != FOLDER:
            getattr(self, self.transport).check()
            if not self.controller_folder:
                raise ConfigurationError(
                    f"transport {self.transport} needs controller_folder: a folder on this "
                    "machine for lock, journal and old tables"
                )
        if self.controller == DEFAULT and not self.options:
            return  # nothing can be wrong: solving a bag need not load a controller
        # Long before a table arrives, which may be hours after the start.
        make_controller(self.controller, self.controller_settings, "options")

    @property
    def accepted(self) -> AcceptedConflicts:
        """What a person accepts; ConfigurationError for a word without a meaning."""
        return AcceptedConflicts(self.accept, self.max_age_days)

    @property
    def controller_settings(self) -> dict[str, Any]:
        """The settings of the controller that ``options`` give."""
        return parse_options(self.options)
