"""The centres of a plate as a model of the engine, to be solved with what other instruments saw.

All unknowns of the exact model of :mod:`.estimate`, from the nominal places: its derivatives there
are those of Eq. 12. Groups of table positions that no ball connects stay in one model, for other
instruments may determine how they stand to each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from rotcal_ros.adjust.designs import Derivatives
from rotcal_ros.adjust.model import CurveModel, Disturbing, Grouping, Model, Steps, Unit
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.estimate import computed, drift_columns
from rotcal_ros.methods.ball_plate.solver.gathering import WORDS
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.repeated_stops import closing_apart
from rotcal_ros.methods.ball_plate.solver.screening import screen
from rotcal_ros.methods.ball_plate.solver.solution import adjust

UM: Final = Unit("um", MICROMETRE)
LARGEST: Final = 1e-4
"""Drift or move, m, that nobody would overlook."""


def curve_model(problem: BallPlateProblem, angles: Floats) -> tuple[CurveModel, Ints]:
    """Return the centres over the six deviations at the table positions in use.

    ``angles``, rad, are those of all table positions; also returns which are in use. Centres that
    :func:`~.result.solve` does without at once are left out. Noise in the plane and along the axis
    are two components. Raises DataError as the screening does, and ObservabilityError where no
    noise is stated and the plate alone cannot determine it.
    """
    whole = screen(closing_apart(problem)[0])[0]
    fields, drifts = model.blocks(whole), 3 * whole.drift
    size, n, first = model.n_unknowns(whole), len(whole.centres), _in_time(whole)
    blocks = {name.replace("_", " "): own.stop - own.start for name, own in fields.items()}
    curves, when = {}, np.repeat(whole.rows, 3).astype(np.float64)
    for name in COMPONENTS:
        at, length = model.component_places(whole, name)
        curves[name] = np.eye(size + drifts)[at] / length
    found = CurveModel(
        Model(
            blocks=blocks | ({"drift": drifts} if drifts else {}),
            observed=whole.centres.ravel()[first],
            std=_noise(whole).ravel()[first],
            equations=_equations(whole),
            outputs=np.zeros((0, size + drifts)),
            words=WORDS,
            unit=UM,
            components=("the centres in the plane", "the centres along the axis"),
            component=np.tile([0, 0, 1], n),
            groupings=[
                Grouping("table position", np.repeat(whole.position, 3)[first]),
                Grouping("ball step", np.repeat(whole.ball_step, 3)[first], when[first]),
            ],
            effects=_effects(whole),
            row_names=[f"{'xyz'[k % 3]} of {whole.row_name(k // 3)}" for k in first.tolist()],
        ),
        angles[whole.table_positions],
        curves,
    )
    return found, whole.table_positions


def _in_time(problem: BallPlateProblem) -> Ints:
    """Return the coordinates (3 n,) in the order of measurement."""
    return np.argsort(np.repeat(problem.rows, 3), kind="stable")


def _effects(problem: BallPlateProblem) -> tuple[Disturbing, ...]:
    """Return what could spoil the centres: a drift of the origin of the CMM, a plate that moved.

    Turns of the plate by what they move its balls.
    """
    n, first = problem.centres.size, _in_time(problem)
    motion = model.plate_motion(problem).reshape(n, 6)[first]
    once, when = np.zeros(n, dtype=np.int64), np.repeat(problem.run_time, 3)[first]
    moved = Steps(once, when, motion)
    drift = drift_columns(problem.run_time, 1).reshape(n, 3)[first]
    return (
        Disturbing("drift", "the origin of the CMM drifts", drift, LARGEST, UM),
        Disturbing("knock", "the plate moved on the table", moved, LARGEST, UM, family=True),
    )


def _noise(problem: BallPlateProblem) -> Floats:
    """Return the standard deviations (n, 3), m: as stated, else as the residuals show them."""
    if problem.std is not None:
        return problem.std
    stated = adjust(problem).noise.used if problem.sigma is None else problem.sigma
    return np.broadcast_to(stated, problem.centres.shape)


def _equations(problem: BallPlateProblem) -> Callable[[Floats], tuple[Floats, Derivatives]]:
    """Return the exact model with the derivatives at the nominal places, a drift behind them."""
    drift = drift_columns(problem.run_time, problem.drift).reshape(problem.centres.size, -1)
    design = np.hstack([model.design_matrix(problem), drift])
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cmm = np.searchsorted(problem.cmm_positions, problem.cmm_index)
    size, first = model.n_unknowns(problem), _in_time(problem)

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        found = model.unpack(problem, x[:size])
        centres = computed(problem, found, found.plate[ball], found.cmm[cmm])
        return (centres.ravel() + drift @ x[size:])[first], design[first]

    return equations
