"""A park of rotary tables whose truth is known: still, drifting, seasonal, and with mishaps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from rotcal_ros.foundation.circumstances import Circumstances, Range
from rotcal_ros.foundation.identity import Identity, InstrumentIdentity, Instruments
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

YEAR_NS = round(365.25 * 86_400e9)
BEGIN_NS = 1_609_459_200_000_000_000  # 2021-01-01
ANGLES = np.arange(24) * 2.0 * np.pi / 24


@dataclass
class Table:
    """A table: its curve (arcsec) at years since the begin, one row of modes cos, sin, cos 2 ...

    ``season`` is an amplitude of the first mode; ``jump`` (year, vector) a crash without a note;
    ``bearing`` (year, vector per year squared) what wears faster and faster.
    """

    serial: str
    start: np.ndarray
    drift: np.ndarray = field(default_factory=lambda: np.zeros(8))
    season: float = 0.0
    jump: tuple[float, np.ndarray] | None = None
    bearing: tuple[float, np.ndarray] | None = None
    walk: float = 0.0
    tolerance: float = 8.0
    u: float = 0.3

    def modes(self, year: float) -> np.ndarray:
        """Return the true coefficients (8,) in arcsec, without random walk."""
        found = self.start + year * self.drift
        found = found + np.eye(8)[0] * self.season * np.sin(2.0 * np.pi * year)
        if self.jump and year >= self.jump[0]:
            found = found + self.jump[1]
        if self.bearing and year >= self.bearing[0]:
            found = found + self.bearing[1] * (year - self.bearing[0]) ** 2
        return found


def basis(angles: np.ndarray = ANGLES) -> np.ndarray:
    """Return the modes (n, 8)."""
    return np.column_stack([f(k * angles) for k in range(1, 5) for f in (np.cos, np.sin)])


def largest(table: Table, year: float) -> float:
    """Return the true largest |deviation| (arcsec) at the measured angles."""
    return float(np.max(np.abs(basis() @ table.modes(year))))


def result(
    serial: str, time_ns: int, deviation: np.ndarray, u: float, *, tolerance: float = 8.0,
    temperature: float | None = None, verdict: str = "ok", instrument: str = "", axis: str = "C",
) -> Result:  # fmt: skip
    """Return a result of ECC; all numbers in arcsec."""
    n = len(deviation)
    used = Instruments(tracer=InstrumentIdentity(serial=instrument))
    identity = Identity(serial=serial, tolerance_arcsec=tolerance, instruments=used)
    warm = None if temperature is None else Range(temperature, temperature, temperature)
    return Result(
        method="tracer_multistation",
        angles=ANGLES[:n],
        deviations={"ECC": deviation * ARCSEC},
        std={"ECC": np.full(n, u * ARCSEC)},
        covariance={"ECC": np.eye(n) * (u * ARCSEC) ** 2},
        sigma0=1.0,
        dof=50,
        n_observations=200,
        verdict=verdict,
        circumstances=Circumstances(
            axis=axis, identity=identity, begun_ns=time_ns, ended_ns=time_ns, temperature_c=warm
        ),
    )


def measured(
    table: Table, years: np.ndarray, rng: np.random.Generator, axis: str = "C"
) -> Iterator[Result]:
    """Yield the results of a table at ``years`` since the begin."""
    walked = np.zeros(8)
    before = years[0]
    for year in years:
        walked = walked + table.walk * np.sqrt(year - before) * rng.standard_normal(8)
        before = year
        deviation = basis() @ (table.modes(year) + walked)
        deviation = deviation + table.u * rng.standard_normal(len(ANGLES))
        time_ns = BEGIN_NS + round(year * YEAR_NS)
        yield result(
            table.serial, time_ns, deviation, table.u, tolerance=table.tolerance, axis=axis
        )


def drawn(number: int, rng: np.random.Generator) -> Table:
    """Return a table that is still, drifts, or breathes with the seasons."""
    table = Table(f"T{number:04d}", rng.normal(0.0, 1.0, 8) / (1 + np.arange(8) // 2))
    kind = number % 4
    if kind == 1:
        table.drift = np.append(rng.normal(0.0, 0.4, 2), np.zeros(6))
    if kind == 2:
        table.season = rng.uniform(0.5, 1.0)
    if kind == 3:
        table.walk = 0.15
    return table
