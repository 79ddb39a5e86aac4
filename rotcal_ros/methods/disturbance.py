"""What may spoil a calibration, as plain physics: one measurement of a plan with or without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.planning.plan import Plan

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import Model
    from rotcal_ros.methods.configuration import Configuration

PPM: Final = 1e-6
ALL_AXES: Final = np.full(3, 1.0 / np.sqrt(3.0))
"""Direction of what may move anywhere: along x, y and z alike."""

Sizes = Mapping[Effect, float]
"""How large each effect is, in the SI unit of its :class:`Disturbance`; absent: not there."""
Stated: TypeAlias = "Callable[[Configuration], float] | None"
"""What reads how much of an effect a configuration allows for, SI; None: nothing is stated."""
Streams = tuple[np.random.Generator, np.random.Generator]
"""Random numbers of the stated noise, and of what is beside it."""


@dataclass(frozen=True)
class Disturbance:
    """One effect on one method: ``what`` happens, and in which unit its size is given.

    A size in SI is ``unit_si`` times one in ``unit``. Sizes from ``start`` on, to ``largest``, are
    worth a search, both in ``unit``. An effect that ``scatters`` is random and hits all angles
    alike; else it has one pattern. ``stated`` returns how much of it (SI) a configuration allows
    for, None where nothing is stated. One that is ``of_turns`` needs a table that turns.
    """

    effect: Effect
    what: str
    unit: str
    unit_si: float
    start: float
    largest: float
    scatters: bool = False
    stated: Stated = None
    of_turns: bool = False


@dataclass(frozen=True, eq=False)
class DisturbedMeasurement:
    """Observations of every step of a plan, true deviations (n,) at its distinct angles."""

    observations: tuple[Observation, ...]
    truth: Mapping[str, Floats]


@dataclass(frozen=True)
class Disturbances:
    """All effects on a method, and the measurement that they disturb.

    ``measure(configuration, plan, sizes, seed)`` draws the stated noise from the seed alone, so
    that two measurements of one seed differ by the effects and nothing else.
    """

    listed: tuple[Disturbance, ...]
    measure: Callable[[Configuration, Plan, Sizes, int], DisturbedMeasurement]


def repeatability(start: float, largest: float) -> Disturbance:
    """Return the repeatability of the table; ``start`` and ``largest`` in arcsec."""
    what = "every arrival of the table is off by itself (k = 1)"
    return Disturbance("repeatability", what, "arcsec", ARCSEC, start, largest, scatters=True)


def error_motion(start: float, largest: float, allowed: Stated = None) -> Disturbance:
    """Return the error motion of the table, beyond what is ``allowed`` for; sizes in um."""
    what = f"EXC and EYC scatter from position to position by so much{_beyond(allowed)}"
    return Disturbance("error motion", what, "um", MICROMETRE, start, largest, True, allowed)


def tilt(start: float, largest: float, allowed: Stated = None) -> Disturbance:
    """Return the tilts of the table, beyond what is ``allowed`` for; sizes in arcsec."""
    what = f"EAC and EBC scatter from position to position by so much{_beyond(allowed)}"
    return Disturbance("tilt", what, "arcsec", ARCSEC, start, largest, True, allowed)


def solver_statement(name: str, unit_si: float = 1.0) -> Callable[[Configuration], float]:
    """Return what reads a statement of the solver's settings, SI."""
    return lambda configuration: float(getattr(configuration.solver, name)) * unit_si


def _beyond(allowed: Stated) -> str:
    return " (k = 1)" if allowed is None else " more (k = 1) than is stated"


def table_deviations(count: int, sizes: Sizes, other: np.random.Generator) -> dict[str, Floats]:
    """Return the true deviations (count,) that ``sizes`` give a perfect table, m and rad."""
    motion = sizes.get("error motion", 0.0) * other.standard_normal((2, count))
    tilts = sizes.get("tilt", 0.0) * other.standard_normal((2, count))
    zero = np.zeros(count)
    return {
        "EXC": motion[0], "EYC": motion[1], "EZC": zero,
        "EAC": tilts[0], "EBC": tilts[1], "ECC": zero,
    }  # fmt: skip


def random_streams(seed: int) -> Streams:
    """Return the random numbers of the noise and, apart from them, those of the effects."""
    return np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])


def relative_times(plan: Plan) -> Floats:
    """Return when each step is measured (n,): from 0 at the first to 1 at the last."""
    return np.linspace(0.0, 1.0, len(plan.steps))


def angle_numbers(plan: Plan) -> Ints:
    """Return which of the distinct angles each table position (p,) of a plan stands at."""
    numbers = {angle: number for number, angle in enumerate(plan.distinct_angles)}
    return np.array([numbers[angle] for angle in plan.table_angles], dtype=np.int64)


def arrival_numbers(plan: Plan) -> Ints:
    """Return the number of the table's arrival at each step (n,): it stands or comes anew."""
    angle = np.array([step.table_angle for step in plan.steps])
    side = np.array([step.approach for step in plan.steps])
    moved = np.diff(angle, prepend=angle[0]) != 0.0
    return np.cumsum(moved | (np.diff(side, prepend=side[0]) != 0))


def arrival_errors(plan: Plan, sizes: Sizes, other: np.random.Generator) -> Floats:
    """Return by how much (rad) the table is off at each step (n,): the same at one arrival."""
    drawn = other.standard_normal(len(plan.steps))
    return np.asarray(
        sizes.get("repeatability", 0.0) * drawn[arrival_numbers(plan)], dtype=np.float64
    )


def of_readings(
    start: float, largest: float, unit: str = "arcsec", unit_si: float = ARCSEC
) -> tuple[Disturbance, ...]:
    """Return what spoils any readings: drifts and knock, of sizes in ``unit``, noise and scale.

    They are those of :func:`~rotcal_ros.adjust.model.instrument_effects`.
    """
    again = "over each run alike, with a straight line, a sine and a cosine of so much each"
    return (
        Disturbance("drift", "linearly from one zero to the next", unit, unit_si, start, largest),
        Disturbance("recurring drift", again, unit, unit_si, start, largest),
        Disturbance("knock", "from one moment on", unit, unit_si, start, largest),
        Disturbance(
            "axis noise", "so many times as stated", "times", 1.0, 1.2, 50.0, scatters=True
        ),
        Disturbance("scale", "all readings too large by so much", "%", 0.01, 1.0, 50.0),
    )


def harmless(*effects: Effect) -> tuple[Disturbance, ...]:
    """Return effects that cannot touch what a method measures: nothing happens, of any size."""
    what = "nothing that is measured feels it: nothing happens"
    return tuple(Disturbance(effect, what, "arcsec", ARCSEC, 1.0, 1.0) for effect in effects)


def simulate_disturbed(
    model: Model, plan: Plan, sizes: Sizes, seed: int, coordinates: int = 1
) -> Floats:
    """Return observations (n,) of a ``model`` of a whole plan, with noise and effects of sizes.

    Its observations are taken for true ones, in the order of the steps, so many ``coordinates``
    for each; where they are made of the block ECC, an arrival that is off moves each as that does.
    Declared effects strike with all their columns alike, a family at one moment.
    """
    noise, other = random_streams(seed)
    exact = model.observed
    found = exact + sizes.get("axis noise", 1.0) * model.std * noise.standard_normal(len(exact))
    off = np.repeat(arrival_errors(plan, sizes, other), coordinates)
    per_turn = np.ones(len(exact))  # of angles themselves; of others what a turn does to them
    if "ECC" in model.blocks:
        from rotcal_ros.adjust.designs import dense
        from rotcal_ros.adjust.model import block_rows

        turned = block_rows(model.blocks, "ECC").sum(axis=0)
        per_turn = dense(model.equations(model.first)[1]) @ turned
    found[: len(off)] += per_turn[: len(off)] * off
    for effect in model.effects:
        columns = effect.whole(exact)
        moment = other.integers(columns.shape[1])
        pattern = columns[:, moment] if effect.family else columns.sum(axis=1)
        found = found + sizes.get(effect.effect, 0.0) * pattern
    return np.asarray(found)


def scatter_in_plane(count: int, size: float, random: np.random.Generator) -> Floats:
    """Return vectors (count, 3) that scatter by ``size`` along x and y, and not along z."""
    vectors = np.zeros((count, 3))
    vectors[:, :2] = size * random.standard_normal((count, 2))
    return vectors
