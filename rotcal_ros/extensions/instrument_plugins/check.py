"""What a check of a cell says about an instrument by plug-in before its driver connects."""

from __future__ import annotations

from rotcal_ros.bags import names
from rotcal_ros.extensions.instrument_plugins.driver import instrument_of
from rotcal_ros.extensions.instrument_plugins.instrument import Tracer, Tracker
from rotcal_ros.extensions.instrument_plugins.settings import InstrumentSettings
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck


def brings(settings: InstrumentSettings) -> tuple[str, ...]:
    """Return the topics of the plug-in; nothing if it cannot be made, which its line reports."""
    try:
        instrument = instrument_of(settings)
    except RotcalError:
        return ()
    lengths = (names.TRACER_LENGTH,) if isinstance(instrument, Tracer) else ()
    places = (names.PROBE_POINT, names.PROBE_TARGET) if isinstance(instrument, Tracker) else ()
    return lengths + places


def look(settings: InstrumentSettings, here: bool, _simulated: bool) -> CheckLine:
    """Return a line on the plug-in; only its driver may connect, since that may move something."""
    title = f"plug-in {settings.plugin}, {settings.address or 'no address'}"
    if here:
        found = f"{title}: node instrument_driver is here"
        return CheckLine("instrument", "plug-in", "note", found)
    try:
        instrument = instrument_of(settings)
    except RotcalError as error:
        todo = "group instrument of the configuration; rotcal settings instrument"
        return CheckLine("instrument", "plug-in", "missing", str(error), todo)
    does = {Tracer: "tells lengths", Tracker: "finds reflectors"}
    found = " and ".join(words for kind, words in does.items() if isinstance(instrument, kind))
    todo = "rotcal run will show whether it answers"
    return CheckLine("instrument", "plug-in", "open", f"{title}: {found}", todo)


CHECK = DriverCheck(brings, look)
