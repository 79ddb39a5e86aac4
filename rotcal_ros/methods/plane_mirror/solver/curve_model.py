"""A mirror's points as a model of the engine, to be solved with what other instruments saw."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.model import CurveModel, Grouping, Model, Unit, linear
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.methods.plane_mirror.solver.drift import swings
from rotcal_ros.methods.plane_mirror.solver.gathering import settled
from rotcal_ros.methods.plane_mirror.solver.linear import linear as linear_view
from rotcal_ros.methods.plane_mirror.solver.problem import WORDS, PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.solve import no_residuals

AXES: Final = ("range", "level", "height")
"""What the errors of a point are called along the beam, level across it, and upwards."""


def curve_model(problem: PlaneMirrorProblem) -> CurveModel:
    """Return pairs of points and readings of nests over ECC, linear about their solution.

    Rows are whitened along the beam, across it, and upwards. Swings of the tracker that nests do
    not show are errors in common; the tilts of the mirror are stated. Raises DataError or
    GeometryError as :func:`~.solve.solve`.
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
        unit=Unit("standard deviations", 1.0),
        components=("the points", *(["the tilts of the mirror"] if stated else [])),
        component=np.repeat([0, 1], [3 * m, stated]),
        judged=np.arange(len(observed)) < 3 * m,
        groupings=[
            Grouping("position", of_rows(view.elements.position)),
            Grouping("station", of_rows(view.elements.station), moment),
        ],
        row_names=[
            *(
                f"{axis} of point {k}"
                for k in row.tolist()
                for axis in ("range", "level", "height")
            ),
            *(f"value {k} of the tilts" for k in range(stated)),
        ],
    )
    common = np.pad(swung.reshape(3 * m, -1), ((0, stated), (0, 0)))
    return CurveModel(model.sharing(common), prepared.angles, {"ECC": np.eye(n, size)})
