"""A mirror's points as a model of the engine, to be solved with what other instruments saw."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.model import (
    MOST_MOMENTS,
    CurveModel,
    Disturbing,
    Grouping,
    Model,
    Steps,
    drifts,
    linear,
)
from rotcal_ros.adjust.stacking import IN_NOISE
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror.solver.drift import swings
from rotcal_ros.methods.plane_mirror.solver.gathering import settled
from rotcal_ros.methods.plane_mirror.solver.linear import Linear
from rotcal_ros.methods.plane_mirror.solver.linear import linear as linear_view
from rotcal_ros.methods.plane_mirror.solver.problem import WORDS, PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.solve import no_residuals
from rotcal_ros.methods.plane_mirror.solver.ways import PreparedWay

AXES: Final = ("range", "level", "height")
"""What the errors of a point are called along the beam, level across it, and upwards."""

LARGEST: Final = 1000.0 * ARCSEC
"""Turn of a mirror or a tracker that nobody would overlook."""


def curve_model(problem: PlaneMirrorProblem) -> tuple[CurveModel, Ints]:
    """Return pairs of points and readings of nests over ECC, linear about their solution.

    Rows are whitened along the beam, across it, and upwards. Swings of the tracker that nests do
    not show are errors in common; the tilts of the mirror are stated. Also returns the
    positions (n,) of the problem that it has. Raises DataError or GeometryError as
    :func:`~.solve.solve`.
    """
    prepared = settled(problem).screened.prepared
    deviations = prepared.curve(no_residuals(problem)).deviations
    view, elements = linear_view(prepared, deviations), prepared.problem
    m, n, size = len(view.elements.row), len(deviations), view.design.shape[2]
    design = np.concatenate([view.design.reshape(3 * m, size), view.prior])
    observed = np.concatenate([view.misclosure.ravel(), view.prior_misclosure])
    observed = observed + design[:, :n] @ deviations
    swung = view.root @ view.elements.carried(swings(elements, prepared.drift))
    stated = len(view.prior)

    def below(columns: Floats) -> Floats:
        return np.pad(columns, ((0, stated), (0, 0)))

    def of_rows(number: Ints) -> Ints:
        return np.append(np.repeat(number, 3), np.full(stated, -1))

    moment = np.append(np.repeat(elements.moment[view.elements.row], 3), np.zeros(stated))

    row = view.elements.row
    model = Model(
        blocks={"deviation": n, "other unknown": size - n},
        observed=observed,
        std=np.ones(len(observed)),
        equations=linear(design),
        outputs=np.zeros((0, size)),
        words=WORDS,
        unit=IN_NOISE,
        components=("the points", *(["the tilts of the mirror"] if stated else [])),
        component=np.repeat([0, 1], [3 * m, stated]),
        judged=np.arange(len(observed)) < 3 * m,
        groupings=[
            Grouping("position", of_rows(view.elements.position)),
            Grouping("station", of_rows(view.elements.station), moment),
        ],
        effects=[e.beside(stated) for e in _effects(view, prepared)],
        row_names=[
            *(
                f"{axis} of point {k}"
                for k in row.tolist()
                for axis in ("range", "level", "height")
            ),
            *(f"value {k} of the tilts" for k in range(stated)),
        ],
    )
    common = below(swung.reshape(3 * m, -1))
    found = CurveModel(model.sharing(common), prepared.angles, {"ECC": np.eye(n, size)})
    return found, prepared.positions


def _effects(view: Linear, prepared: PreparedWay) -> tuple[Disturbing, ...]:
    """Return what could spoil the points: the mirror, or the tracker at a station, turns.

    A mirror that turned or leans does so at all positions that come after.
    """
    elements, problem, n = view.elements, prepared.problem, len(prepared.angles)
    several = 2 if len(view.prior) else 1  # a reflector on the table leans no way
    # a pair feels the deviation and the tilt of its own position only
    turns = view.design[:, :, : several * n].reshape(-1, several, n).sum(axis=2)
    moment = np.repeat(elements.moment, 3)
    once = np.where(np.repeat(elements.position, 3) >= 0, 0, -1)
    station, when = np.repeat(problem.station, 3), np.repeat(problem.moment, 3)
    sideways = np.cross([0.0, 0.0, 1.0], problem.xyz).reshape(-1, 1)  # per rad of azimuth

    def seen(moved: Floats) -> Floats:
        """Return what moves (3 n, k) of all points, m, change."""
        each = moved.reshape(*problem.xyz.shape, moved.shape[1])
        return (view.root @ elements.carried(each)).reshape(len(moment), moved.shape[1])

    mirror, tracker = "the mirror turned on the table", "the tracker turned"
    drifting, drifted = drifts(once, moment) * turns, drifts(station, when) * sideways
    knocked, moved = Steps(once, moment, turns), Steps(station, when, sideways)
    return (
        Disturbing("drift", "the mirror turns slowly on the table", drifting, LARGEST),
        Disturbing("drift", "the tracker turns slowly", seen(drifted), LARGEST, family=True),
        Disturbing("knock", mirror, knocked, LARGEST, family=True),
        Disturbing("knock", tracker, seen(moved.some(MOST_MOMENTS)), LARGEST, family=True),
    )
