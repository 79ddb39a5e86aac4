"""Lengths that count vacuum wavelengths, corrected for the index of refraction of the air.

A tracer that corrects nothing reads n D - P, with the index n at that time, the distance D and a
constant P, about the optical path where it reads zero. What is recorded stays as it was read: the
correction is part of solving.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.refraction import EQUATIONS, Air, Equation, Sensors, index_std
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.added_errors import with_errors
from rotcal_ros.methods.air_settings import AirSettings

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel

Observations = Sequence[Observation]
BY_INSTRUMENT: Final = "corrected by the instrument, not here"
_COLUMNS: Final = {
    "temperature_c": ("temperature", "temperature"),
    "pressure_pa": ("air_pressure", "pressure"),
    "humidity": ("relative_humidity", "humidity"),
}
"""Column of an observation and setting of the air -> topic, quantity of the capture."""


@dataclass(frozen=True)
class Refraction:
    """What is done about the index of refraction; ``lengths``: whether the method has any."""

    settings: AirSettings
    source: str
    lengths: bool

    @property
    def equation(self) -> Equation | None:
        """The equation that corrects; None where nothing is corrected here."""
        return EQUATIONS.get(self.settings.refraction) if self.lengths else None

    def require_sources(self, capture: CaptureSettings) -> None:
        """Raise ConfigurationError, before anything moves, for air that will not be reported."""
        if self.equation is None:
            return
        for column, (topic, quantity) in _COLUMNS.items():
            expected = getattr(capture, f"{quantity}_expected")
            if getattr(self.settings, column) is None and not expected:
                raise ConfigurationError(
                    f"{self.source}: air: refraction {self.settings.refraction} needs {column}: "
                    f"publish {topic} and set capture.{quantity}_expected: true, or give "
                    f"air.{column}"
                )

    def required(self, capture: CaptureSettings) -> frozenset[str]:
        """Return the quantities of the capture without which a length cannot be corrected."""
        if self.equation is None:
            return frozenset()
        return frozenset(
            quantity
            for column, (_, quantity) in _COLUMNS.items()
            if getattr(self.settings, column) is None and getattr(capture, f"{quantity}_expected")
        )

    def corrected(self, observations: Observations) -> tuple[Observation, ...]:
        """Return the observations with lengths of distance instead of optical path.

        Raises DataError where an observation does not report the air.
        """
        return self._over(observations, 0.0)

    def solve(self, observations: Observations, solve: Callable[[Any], Result]) -> Result:
        """Solve corrected observations; what the index is uncertain by is part of the result.

        One error of the sensors and of the equation is common to all lengths: the solution with
        every index larger by its standard uncertainty shows what that does to each deviation.
        """
        if self.equation is None:
            return solve(tuple(observations))
        result = solve(self.corrected(observations))
        return with_common(result, solve(self._over(observations, 1.0)))

    def model_of_curves(
        self, observations: Observations, find: Callable[[Any], CurveModel | None]
    ) -> CurveModel | None:
        """Return the model of corrected observations; the error of the index is theirs in common.

        None where that error changes what is left out before.
        """
        found = find(self.corrected(observations))
        if self.equation is None or found is None:
            return found
        moved = find(self._over(observations, 1.0))
        if moved is None or moved.model.names != found.model.names:
            return None
        error = moved.model.observed - found.model.observed
        return replace(found, model=found.model.with_common_errors(error[:, None]))

    def describe(self, observations: Observations) -> str:
        """Say who corrects, by what, and how uncertain it is; empty without lengths."""
        if not self.lengths:
            return ""
        equation, settings = self.equation, self.settings
        if equation is None:
            return BY_INSTRUMENT
        air = self._air(observations)
        index = equation.index(air, settings.vacuum_wavelength_nm, settings.co2_ppm)
        std = float(np.max(self._std(air, equation)))
        return phrase(
            "{0} with {1:g} nm in vacuum, CO2 {2:g} umol/mol, dead path {3:g} m: index {4:.8f} "
            "to {5:.8f}, standard uncertainty {6:.1e} from {7:g} K, {8:g} Pa, {9:g} of humidity "
            "and {10:.0e} of the equation, common to all lengths and part of the uncertainties",
            equation.name, settings.vacuum_wavelength_nm, settings.co2_ppm, settings.dead_path_m,
            index.min(), index.max(), std, settings.temperature_std_k, settings.pressure_std_pa,
            settings.humidity_std, equation.std
        )  # fmt: skip

    def _over(self, observations: Observations, errors: float) -> tuple[Observation, ...]:
        """Return the observations corrected with every index ``errors`` of its std larger."""
        equation, settings = self.equation, self.settings
        if equation is None or not observations:
            return tuple(observations)
        air = self._air(observations)
        index = equation.index(air, settings.vacuum_wavelength_nm, settings.co2_ppm)
        index = index + errors * self._std(air, equation)
        dead = settings.dead_path_m
        # (n D - P + d) / n - d is D less a constant, but for P - d times the changes of the index
        return tuple(
            replace(o, mean=tuple((length + dead) / n - dead for length in o.mean))
            if o.kind == PointKind.REFLECTOR
            else o
            for o, n in zip(observations, index.tolist(), strict=True)
        )

    def _std(self, air: Air, equation: Equation) -> Floats:
        settings = self.settings
        sensors = Sensors(
            settings.temperature_std_k, settings.pressure_std_pa, settings.humidity_std
        )
        wavelength, co2 = settings.vacuum_wavelength_nm, settings.co2_ppm
        return index_std(equation, air, sensors, wavelength, co2)

    def _air(self, observations: Observations) -> Air:
        return Air(**{column: self._column(observations, column) for column in _COLUMNS})

    def _column(self, observations: Observations, column: str) -> Floats:
        """Return what was captured, else what is given; DataError where it is neither."""
        given, (topic, quantity) = getattr(self.settings, column), _COLUMNS[column]
        values = [getattr(o, column) for o in observations]
        known = [given if value is None else value for value in values]
        if None in known:
            step = observations[known.index(None)].step
            raise DataError(
                f"step {step}: its length cannot be corrected by {self.settings.refraction}, the "
                f"{column} of the air is not known: capture {topic} "
                f"(capture.{quantity}_expected: true) or give air.{column}"
            )
        return np.array(known, dtype=np.float64)


def with_common(result: Result, moved: Result) -> Result:
    """Return a result whose uncertainties hold an error that is common to all that was measured.

    ``moved`` is the result with this error at its standard uncertainty: the differences of the
    deviations are fully correlated.
    """
    if moved.components != result.components or len(moved.angles) != len(result.angles):
        raise DataError(
            "the index of refraction cannot be judged: other angles or deviations are solved with "
            "every index larger by its standard uncertainty; measure more lengths"
        )
    shift = {n: moved.deviations[n] - values for n, values in result.deviations.items()}
    sides = {
        n: np.append(
            moved.directions[n].forward - d.forward, moved.directions[n].reverse - d.reverse
        )
        for n, d in result.directions.items()
    }
    columns = ({n: values[:, None] for n, values in each.items()} for each in (shift, sides))
    return with_errors(result, *columns)
