"""The settings of the bridge to a controller: group ``bridge`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros import plugins
from rotcal_ros.compensation.options import parse_options
from rotcal_ros.settings import setting

DEFAULT: Final = "csv"


@dataclass(frozen=True)
class BridgeSettings:
    """Which controller gets tables, in which form, and how far they may change it.

    Raises ConfigurationError for options that the controller does not take.
    """

    controller: str = setting(
        DEFAULT, doc="kind of controller", choices=plugins.names(plugins.CONTROLLERS)
    )
    options: tuple[str, ...] = setting((), doc="controller settings, each as NAME=VALUE")
    spacing_deg: float = setting(
        10.0, doc="deg, distance of the rows", minimum=1e-3, maximum=180.0
    )
    reference_deg: float | None = setting(
        None, doc="deg, angle with correction zero; none: the table's own"
    )
    output_folder: str = setting(
        "", doc="folder that takes the files of every table; empty: no files are written"
    )
    controller_folder: str = setting(
        "", doc="folder that the controller loads its table from; empty: nothing can be applied"
    )
    max_change_arcsec: float = setting(
        60.0,
        doc="arcsec, largest change of the correction that may be applied",
        minimum=0.0,
        maximum=36_000.0,
    )
    accept_unverified: bool = setting(
        False, doc="write files although something about the controller is not verified"
    )
    answer_timeout_s: float = setting(
        5.0, doc="s, after which the controller counts as silent", minimum=0.01, maximum=600.0
    )

    def __post_init__(self) -> None:
        if self.controller == DEFAULT and not self.options:
            return  # nothing can be wrong: solving a bag need not load a controller
        from rotcal_ros.compensation.controllers import make_controller

        # Long before a table arrives, which may be hours after the start.
        make_controller(self.controller, self.controller_settings, "options")

    @property
    def controller_settings(self) -> dict[str, Any]:
        """The settings of the controller that ``options`` give."""
        return parse_options(self.options)
