"""One residual per row, used or not, with its redundancy and test value."""

from __future__ import annotations

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.plane_mirror.layout import Nests, Pairs
from rotcal_ros.methods.plane_mirror.nest_tests import NestFit
from rotcal_ros.methods.plane_mirror.normals import Normals, condition_jacobian, tangent_basis
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.results import Residuals


def empty_residuals(problem: PlaneMirrorProblem) -> Residuals:
    """Return residuals in which no row is used yet (all zero)."""
    n = len(problem.xyz)
    return Residuals(
        table_index=problem.position.copy(),
        target=problem.nest.copy(),
        residual=np.zeros(n),
        redundancy=np.zeros(n),
        test_value=np.zeros(n),
        used=np.zeros(n, dtype=np.bool_),
    )


def enter(residuals: Residuals, rows: Ints, length: Floats, share: Floats, test: Floats) -> None:
    """Write the residual lengths (m), redundancies and test values of ``rows`` as used."""
    residuals.residual[rows] = length
    residuals.redundancy[rows] = np.clip(share, 0.0, 1.0)
    residuals.test_value[rows] = test
    residuals.used[rows] = True


def enter_nests(residuals: Residuals, nests: Nests, fit: NestFit) -> None:
    """Write the nests: distance of each from where the registration places it."""
    length = np.linalg.norm(fit.residual, axis=1)
    enter(residuals, nests.row, length, fit.redundancy, fit.test_value)


def enter_pairs(
    residuals: Residuals,
    problem: PlaneMirrorProblem,
    pairs: Pairs,
    normals: Normals,
    weight: Floats,
) -> None:
    """Write direct and mirrored rows: distance of each from where its group's plane wants it.

    A single pair fits its plane exactly; it is checked by the cone and the overlaps alone and has
    redundancy 0 here.
    """
    jacobian = condition_jacobian(problem.xyz[pairs.direct], normals.normal, normals.offset, pairs)
    basis = tangent_basis(normals.normal)[pairs.group]
    reduced = jacobian @ basis
    information = np.swapaxes(basis, 1, 2) @ normals.information[pairs.group] @ basis
    cofactor = np.linalg.inv(weight) - reduced @ np.linalg.solve(
        information, np.swapaxes(reduced, 1, 2)
    )
    n = normals.normal[pairs.group]
    reflection = np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :]
    pull = (weight @ normals.misclosure[..., None])[..., 0]
    share = np.trace(weight @ cofactor, axis1=1, axis2=2)
    square = np.einsum("pi,pi->p", normals.misclosure, pull)
    test = np.sqrt(square / np.where(share > 1e-6, share, np.inf))
    for rows, factor in ((pairs.direct, reflection), (pairs.mirrored, np.eye(3))):
        covariance = problem.noise.covariance(problem.xyz[rows])
        spread = covariance @ factor @ weight
        length = np.linalg.norm(np.einsum("pij,pj->pi", covariance @ factor, pull), axis=1)
        own = np.trace(spread @ cofactor @ weight @ factor, axis1=1, axis2=2) / 3.0
        enter(residuals, rows, length, own, test)
