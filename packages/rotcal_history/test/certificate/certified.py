"""A result that states all that a certificate needs."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import rotcal_ros as rc
from rotcal_ros.foundation.circumstances import Circumstances, Range
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import AxisLine

DATA = Path(__file__).parents[4] / "examples" / "data"
IDENTITY = {
    "item": "rotary table", "maker": "Maker & Sons", "model": "T 200", "serial": "0017",
    "place": "hall 3", "operator": "A. Operator", "laboratory": "Laboratory of the example",
    "laboratory_address": "Street 1, Town", "laboratory_country": "DE",
    "laboratory_email": "lab@example.org", "customer": "Customer", "received": "2026-03-01",
    "customer_address": "Street 2, Town", "customer_number": "4711",
    "certificate_number": "2026-0001",
    "instruments": {
        "tracer": {"maker": "M", "model": "T", "serial": "9", "calibrated": "2026-01-15"},
        "ball_plate": {"serial": "12", "calibrated": "2025-12-01", "certificate": "B 77"},
    },
}  # fmt: skip
DAY_NS = 86_400 * 10**9
AXIS = AxisLine(
    ("XOC", "YOC", "AOC", "BOC"),
    np.array([1.1e-4, -7e-5, 2e-5, -3e-5]),
    np.array([1e-6, 2e-6, 3e-6, 4e-6]),
    np.diag([1e-12, 4e-12, 9e-12, 1.6e-11]) + 1e-13,
    np.array([0.0, 0.0, 0.08]),
)


def certified(name="ball_plate", identity=IDENTITY, **changes):
    """Return a result of the examples, measured on 10 and 11 March 2026."""
    circumstances = Circumstances(
        axis="C",
        identity=Identity.from_dict(identity),
        begun_ns=20_522 * DAY_NS + 1,
        ended_ns=20_523 * DAY_NS,
        temperature_c=Range(20.1, 19.9, 20.2),
        pressure_pa=Range(101_300.5, 101_200.0, 101_400.0),
        humidity=Range(0.45, 0.44, 0.46),
        refraction="corrected by the instrument, not here",
    )
    result = rc.read_result(DATA / f"result_{name}.json")
    return replace(result, circumstances=replace(circumstances, **changes))


def certified_axis():
    """Return such a result that says where the axis stands, too."""
    return replace(certified(), axes=(AXIS,))
