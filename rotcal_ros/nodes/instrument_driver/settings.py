"""The settings of an instrument by plug-in: group ``instrument`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, setting


@dataclass(frozen=True)
class InstrumentSettings:
    """Which plug-in drives the instrument, where it is, and how long its driver waits."""

    plugin: str = setting("", doc="name of an installed plug-in of rotcal_ros.instruments")
    address: str = setting(
        "", doc="address of the instrument, in the form of its plug-in, such as 192.168.0.1:700"
    )
    options: tuple[str, ...] = setting((), doc="options of the plug-in, each name=value")
    silence_s: float = expert(
        2.0,
        minimum=0.05,
        maximum=3600.0,
        doc="s, time without a length after which the connection counts as lost",
    )
    measure_timeout_s: float = expert(
        30.0, doc="s, longest measurement of one place", minimum=0.1, maximum=3600.0
    )
    reconnect_s: ClassVar[
        Annotated[
            float,
            "an instrument that restarts takes longer, a network less",
        ]
    ] = 2.0

    def by_name(self) -> dict[str, str]:
        """Return the options by name; ConfigurationError for one without a value."""
        pairs = [option.partition("=") for option in self.options]
        for name, equals, _ in pairs:
            if not (name and equals):
                raise ConfigurationError(
                    f"instrument.options: {name!r:.80} is not name=value: write it so"
                )
        return {name: value for name, _, value in pairs}
