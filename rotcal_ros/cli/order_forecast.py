"""The forecast of an order of measurement for people and for programs."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from rotcal_ros.components import COMPONENTS, unit_of
from rotcal_ros.protection import TOLERABLE
from rotcal_ros.units import ARCSEC, MICROMETRE

if TYPE_CHECKING:
    from rotcal_ros.planning.order_forecast import OrderForecast, UnitEffect

_WORDS = {"drift": "CMM drifts in", "shift": "plate shifted along", "turn": "plate turned about"}


def forecast_lines(forecast: OrderForecast) -> list[str]:
    """Return the table of an order: errors by one unit, and the size from which on it is found."""
    names = "".join(f"{name:>9s}" for name in COMPONENTS)
    labels = "".join(f"{unit_of(name)[1]:>9s}" for name in COMPONENTS)
    lines = [
        f"  {'largest error by':29s}{names}   found from     error then",
        f"  {'':29s}{labels}   (95 %)         (std)",
    ]
    lines += [_line(effect) for effect in forecast.effects]
    lines.append(
        f"  unseen at worst: drift {_std(forecast.drift_unseen)}, knock "
        f"{_std(forecast.knock_unseen)}"
    )
    return lines


def _line(effect: UnitEffect) -> str:
    unit, label = (ARCSEC, "arcsec") if effect.kind == "turn" else (MICROMETRE, "um")
    errors = "".join(f"{unit * effect.error[n] / unit_of(n)[0]:9.3f}" for n in COMPONENTS)
    name = f"{_WORDS[effect.kind]} {effect.axis}, 1 {label}"
    found = f"{effect.found_from / unit:.3f} {label}" if isfinite(effect.found_from) else "never"
    unseen = f"{effect.unseen:.2f}" if isfinite(effect.unseen) else "unbounded"
    return f"  {name:29s}{errors}   {found:13s}  {unseen}"


def _std(error: float) -> str:
    if not isfinite(error):
        return "without bound (not protected)"
    return f"{error:.2f} standard deviations" + (" (not protected)" if error > TOLERABLE else "")


def forecast_dict(forecast: OrderForecast) -> dict[str, Any]:
    """Return the forecast in SI; None where nothing is found, or nothing bounds an error."""
    return {
        "unseen_std": {
            "drift": _finite(forecast.drift_unseen),
            "knock": _finite(forecast.knock_unseen),
        },
        "effects": [
            {
                "kind": effect.kind,
                "axis": effect.axis,
                "error_per_unit": effect.error,
                "found_from": _finite(effect.found_from),
                "unseen_std": _finite(effect.unseen),
            }
            for effect in forecast.effects
        ],
    }


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
