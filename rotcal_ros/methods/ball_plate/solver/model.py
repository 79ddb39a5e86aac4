"""The linear model of the reduced three-rosette method (Eq. 12 to 19 of the paper).

    m = p_k + c_i x p_k + B_i a_j + d_i + b_k + u x p_k + v,      i = k - j (mod N)

B_i turns by the table angle 2 pi i / N about z, p_k is the nominal place of a ball at the CMM
position k. The unknowns stand in one vector in the order a, b, c, d, u, v; its length is P.
Rotations (c, u) are multiplied by the radius of the ball circle, so that all unknowns are lengths
of the same size.

The 19 constraints G xi = 0 take away what the measurement cannot see: 19 directions of the
unknowns that leave all centres where they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from rotcal_ros.adjust.effects import Seen
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.geometry.rotations import cross_matrix, rotation_about_z
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle

N_CONSTRAINTS = 19
ROUNDING = 4.0 * np.finfo(np.float64).eps
"""Smallest error of a coordinate that means anything, as part of the radius."""
EXACT = 1e4
"""Data whose residuals have less than so many times the variance of rounding count as exact."""
FIELDS = ("plate", "cmm", "rotation", "translation", "axis_rotation", "axis_shift")
TABLE_COMPONENTS = {
    "EXC": ("translation", 0),
    "EYC": ("translation", 1),
    "EZC": ("translation", 2),
    "EAC": ("rotation", 0),
    "EBC": ("rotation", 1),
    "ECC": ("rotation", 2),
}
PARTS = ([0, 1, 5], [2, 3, 4])
"""Two independent parts of a motion (shift x, y, z and turn about x, y, z): what moves centres in
x and y, and what moves them in z. Of the deviations, EXC to ECC, each moves its own."""


@dataclass(frozen=True)
class PlateParameters:
    """Everything the method finds, its standard deviations, or what causes it.

    ``plate`` (R, 3) are the errors a_j of the balls at table position 0, ``cmm`` (S, 3) those
    b_k of the CMM, ``rotation`` (M, 3) and ``translation`` (M, 3) the table's c_i and d_i at the
    table positions in use, ``axis_rotation`` (3,) and ``axis_shift`` (3,) the pose u, v of the
    axis. Radians and metres. Of m causes at once every field has m as its last axis.
    """

    plate: Floats
    cmm: Floats
    rotation: Floats
    translation: Floats
    axis_rotation: Floats
    axis_shift: Floats

    def component(self, name: str) -> Floats:
        """Return the table's component of the ISO 230-1 ``name`` (M,)."""
        field, axis = TABLE_COMPONENTS[name]
        column: Floats = getattr(self, field)[:, axis]
        return column

    def merged(self, function: Callable[..., Floats], *others: PlateParameters) -> PlateParameters:
        """Return what a ``function`` makes of each field and the same field of ``others``."""
        every = (self, *others)
        return PlateParameters(*(function(*(getattr(p, f) for p in every)) for f in FIELDS))

    def curves(self) -> Floats:
        """Return the six components (6, M) in the order of ``COMPONENTS``, m and rad."""
        return np.array([self.component(name) for name in COMPONENTS])


@dataclass(frozen=True)
class OriginDrift:
    """An estimated drift of the CMM's origin, metres over the run, (degree, 3) in x, y, z.

    The first row is the linear part, the second the bow: what it adds at both ends of the run to
    the middle. ``unit_covariance`` (3 degree, 3 degree) is for unit standard deviation.
    """

    amount: Floats
    unit_covariance: Floats


@dataclass(frozen=True)
class Solution:
    """Least squares solution of one problem; covariances are for unit standard deviation.

    ``unit_std`` and ``unit_covariance(first, second)`` (M, M), the covariance of two of the
    table's components, belong to sigma = 1 m (or to sigma0 = 1 when the rows have their own
    ``std``): multiply by sigma and sigma^2. ``residuals`` (n, 3), metres, are observed -
    computed; ``cofactor()`` (n, 3, 3) is their unit covariance. ``weighted_square_sum`` is w'w.
    """

    estimate: PlateParameters
    unit_std: PlateParameters
    unit_covariance: Callable[[str, str], Floats]
    residuals: Floats
    cofactor: Callable[[], Floats]
    weighted_square_sum: float
    dof: int
    way: str
    drift: OriginDrift | None = None


class LinearFit(ABC):
    """The factored linear model of a problem, ready for any number of right-hand sides.

    ``way``: how it is solved. Covariances are for unit standard deviation, as of a
    :class:`Solution`.
    """

    way: str

    def __init__(self, problem: BallPlateProblem) -> None:
        self.problem = problem
        self.dof = degrees_of_freedom(problem)

    @abstractmethod
    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""

    @property
    @abstractmethod
    def unit_std(self) -> PlateParameters:
        """The standard deviations of all parameters."""

    @abstractmethod
    def unit_covariance(self, first: str, second: str) -> Floats:
        """Return the covariance (M, M) of two of the table's components."""

    @abstractmethod
    def cofactor(self) -> Floats:
        """Return the covariance (n, 3, 3) of the residuals."""

    def solution(self, estimate: PlateParameters, residuals: Floats) -> Solution:
        """Return parameters and residuals (n, 3) with their covariances."""
        return Solution(
            estimate=estimate,
            unit_std=self.unit_std,
            unit_covariance=self.unit_covariance,
            residuals=residuals,
            cofactor=self.cofactor,
            weighted_square_sum=weighted_square_sum(self.problem, residuals),
            dof=self.dof,
            way=self.way,
        )

    def solve(self, observed: Floats) -> Solution:
        """Return the solution for deviations (n, 3)."""
        return self.solution(*self.fit(observed))

    def responses(self, displacements: Floats) -> tuple[PlateParameters, Floats, Floats]:
        """Return what units of ``displacements`` (n, 3, m) do, each in the plane or along z.

        The parameters and residuals (n, 3, m) that each causes, and the information (m, m) that
        residuals keep of them, in units of the rows' ``std``. The model keeps z apart from x and
        y: one in the plane and one along z share a fit.
        """
        axial = np.asarray(displacements[:, 2].any(axis=0))
        remains = np.zeros_like(displacements)
        caused: dict[int, PlateParameters] = {}
        for pair in zip_longest(np.flatnonzero(~axial).tolist(), np.flatnonzero(axial).tolist()):
            numbers = [number for number in pair if number is not None]
            found, left = self.fit(displacements[:, :, numbers].sum(axis=2))
            for number in numbers:
                axes = np.where(axial[number], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0])
                caused[number], remains[:, :, number] = scaled(found, axes), left * axes
        first, *others = (caused[number] for number in range(len(axial)))
        weighted = (self.problem.weights[:, :, None] * remains).reshape(-1, len(axial))
        kept = weighted.T @ displacements.reshape(-1, len(axial))
        parameters = first.merged(lambda *fields: np.stack(fields, axis=-1), *others)
        return parameters, remains, 0.5 * (kept + kept.T)

    def seen(self, displacements: Floats, residuals: Floats | None = None) -> Seen:
        """Return what is seen of ``displacements`` (n, 3, m), as of :meth:`responses`.

        Outputs are the six deviations, M values each, in the order of ``COMPONENTS``. The score is
        that of ``residuals`` (n, 3), zero without.
        """
        parameters, _, information = self.responses(displacements)
        weighted = self.problem.weights[:, :, None] * displacements
        return Seen(
            parameters.curves().reshape(-1, len(information)).T,
            information,
            np.zeros(len(information))
            if residuals is None
            else np.einsum("nia,ni->a", weighted, residuals),
            np.einsum("nia,nia->a", weighted, displacements),
        )

    def seen_of_plate(self, there: Bools) -> Seen:
        """Return likewise what :func:`plate_motion` does where ``there`` (n,) is true."""
        return self.seen(plate_motion(self.problem) * there[:, None, None])


def scaled(unit: PlateParameters, axes: Floats) -> PlateParameters:
    """Scale standard deviations: ``axes`` (3,) belong to x, y (the same) and z of a centre.

    Rotations about x and y are measured along z, the one about z in the plane.
    """
    turned = axes[[2, 2, 0]]
    return PlateParameters(
        plate=unit.plate * axes,
        cmm=unit.cmm * axes,
        rotation=unit.rotation * turned,
        translation=unit.translation * axes,
        axis_rotation=unit.axis_rotation * turned,
        axis_shift=unit.axis_shift * axes,
    )


def of_component(axes: Floats, name: str) -> float:
    """Return that of ``axes`` (3,), x, y (the same) and z, which a component follows."""
    return float(axes[2] if name in ("EZC", "EAC", "EBC") else axes[0])


def weighted_square_sum(problem: BallPlateProblem, residuals: Floats) -> float:
    """Return w'w: residuals in metres, or in units of ``std`` where every row has its own."""
    white = (residuals / problem.noise_unit).ravel()
    return float(white @ white)


def rounding_variance(problem: BallPlateProblem) -> float:
    """Return the variance of rounding alone of a centre, in units of ``std`` if there is one."""
    return float((ROUNDING * problem.radius / problem.noise_unit.min()) ** 2)


def least_variance(problem: BallPlateProblem, found: PlateParameters) -> float:
    """Return the variance that centres without noise leave, in units of ``std`` if there is one.

    It comes from their last bits, and from the product of the errors of plate and CMM over the
    radius: the model takes the CMM's error to be the same wherever around its position the errors
    of the plate take a ball. Tests divide by no less, or exact data would be rejected.
    """
    # place and attitude of the whole plate are taken off: the table's own motion takes those
    mounting = rigid_motion(problem.angles[problem.balls]).reshape(-1, 6)
    plate = found.plate.ravel()
    plate = plate - mounting @ np.linalg.lstsq(mounting, plate, rcond=None)[0]
    products = 3.0 * np.sqrt(np.mean(plate**2) * np.mean(found.cmm**2)) / problem.radius
    smallest = float(problem.noise_unit.min())
    return max(EXACT * rounding_variance(problem), float(products / smallest) ** 2)


def degrees_of_freedom(problem: BallPlateProblem) -> int:
    """Return observations - unknowns + constraints."""
    return 3 * len(problem.centres) - n_unknowns(problem) + N_CONSTRAINTS


def _cross_unit(angles: Floats) -> Floats:
    """Return the matrices C with C w = w x (cos, sin, 0), (n, 3, 3)."""
    return cross_matrix(-on_circle(angles))


def rigid_motion(angles: Floats) -> Floats:
    """Return what a shift x, y, z and a rotation times radius do to points of the circle.

    (n, 3, 6) displacements per metre of each, of the points at ``angles`` (n,), rad.
    """
    cross = _cross_unit(angles)
    return np.concatenate([np.broadcast_to(np.eye(3), cross.shape), cross], axis=2)


def plate_motion(problem: BallPlateProblem) -> Floats:
    """Return likewise (n, 3, 6) what a motion of the plate on the table does to the centres.

    The motion is given in the frame of the table at position 0.
    """
    x, y, _ = on_circle(problem.angles).T
    table, ball, place = problem.position, problem.ball_step, problem.cmm_index
    motion = np.zeros((len(table), 3, 6))
    motion[:, 0, 0], motion[:, 1, 0] = x[table], y[table]
    motion[:, 0, 1], motion[:, 1, 1] = -y[table], x[table]
    motion[:, 2, 2] = 1.0
    motion[:, 2, 3], motion[:, 2, 4] = y[ball], -x[ball]
    motion[:, 0, 5], motion[:, 1, 5] = -y[place], x[place]
    return motion


def blocks(problem: BallPlateProblem) -> dict[str, slice]:
    """Return where each of FIELDS stands in the vector of unknowns."""
    turned = len(problem.table_positions)
    counts = (len(problem.balls), len(problem.cmm_positions), turned, turned, 1, 1)
    ends = (3 * np.cumsum(counts)).tolist()
    return {f: slice(end - 3 * n, end) for f, n, end in zip(FIELDS, counts, ends, strict=True)}


def n_unknowns(problem: BallPlateProblem) -> int:
    """Return the number P of unknowns."""
    return int(blocks(problem)[FIELDS[-1]].stop)


def component_places(problem: BallPlateProblem, name: str) -> tuple[Ints, float]:
    """Return where the unknowns (M,) of a component stand, and the length that divides them."""
    field, axis = TABLE_COMPONENTS[name]
    own = blocks(problem)[field]
    length = problem.radius if field == "rotation" else 1.0
    return np.arange(own.start + axis, own.stop, 3), length


def local_design(problem: BallPlateProblem) -> tuple[Floats, Ints]:
    """Return the 18 non-zero columns of every row: (n, 3, 18) coefficients, (n, 18) indices."""
    n = len(problem.centres)
    turn = rotation_about_z(problem.angles)[problem.position]
    cross = _cross_unit(problem.angles)[problem.cmm_index]
    identity = np.broadcast_to(np.eye(3), (n, 3, 3))
    coefficients = np.concatenate([turn, identity, cross, identity, cross, identity], axis=2)
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cmm = np.searchsorted(problem.cmm_positions, problem.cmm_index)
    axis = np.zeros(n, dtype=np.int64)
    numbers = (ball, cmm, problem.table_index, problem.table_index, axis, axis)
    places = zip(blocks(problem).values(), numbers, strict=True)
    starts = np.stack([own.start + 3 * number for own, number in places], axis=1)
    columns = (starts[:, :, None] + np.arange(3)).reshape(n, 18)
    return coefficients, columns


def design_matrix(problem: BallPlateProblem) -> Floats:
    """Return T (3n, P) of Eq. 14; rows in the order of the centres, x, y, z of each."""
    coefficients, columns = local_design(problem)
    n = len(problem.centres)
    matrix = np.zeros((n, 3, n_unknowns(problem)))
    # a centre touches every column at most once, so plain assignment is enough
    np.put_along_axis(matrix, np.repeat(columns[:, None, :], 3, axis=1), coefficients, axis=2)
    return matrix.reshape(3 * n, -1)


def constraint_matrix(problem: BallPlateProblem) -> Floats:
    """Return G (19, P) of the constraints G xi = 0 (Eq. 15 to 19)."""
    plate, cmm, rotation, translation, _, _ = blocks(problem).values()
    angles = problem.angles
    matrix = np.zeros((N_CONSTRAINTS, n_unknowns(problem)))
    identity = np.eye(3)
    across = angles[problem.cmm_positions]
    back = rotation_about_z(angles[problem.table_positions]).transpose(0, 2, 1)
    ball = rotation_about_z(angles[problem.balls])
    matrix[0:3, cmm] = np.tile(identity, len(problem.cmm_positions))  # Eq. 15, left
    matrix[3:6, cmm] = -np.hstack(list(_cross_unit(across)))  # Eq. 15, right
    matrix[6, cmm] = on_circle(across).ravel()  # Eq. 16
    matrix[7:10, rotation] = matrix[10:13, translation] = np.tile(identity, len(back))  # Eq. 17
    matrix[13:15, rotation] = matrix[15:17, translation] = np.hstack(list(back[:, :2]))  # Eq. 18
    matrix[17, plate] = ball[:, :, 1].ravel()  # Eq. 19, tangential
    matrix[18, plate][2::3] = 1.0  # Eq. 19, axial
    return matrix


def null_space(problem: BallPlateProblem) -> Floats:
    """Return the 19 directions (P, 19) that the measurement cannot see.

    What they are: a plate shifted (3) or turned (3) on a table that makes up for it; a table
    with a constant shift (3) or rotation (3), an axis shifted (3) or turned (3), taken back by
    the CMM; a CMM circle and a plate that are larger and smaller (1).
    """
    plate, cmm, rotation, translation, axis_rotation, axis_shift = blocks(problem).values()
    space = np.zeros((n_unknowns(problem), N_CONSTRAINTS))
    identity = np.eye(3)
    turn = rotation_about_z(problem.angles[problem.table_positions]).reshape(-1, 3)
    constant = np.tile(identity, (len(problem.table_positions), 1))
    all_cmm = np.tile(identity, (len(problem.cmm_positions), 1))
    ball_angles, cmm_angles = problem.angles[problem.balls], problem.angles[problem.cmm_positions]
    cross_ball = _cross_unit(ball_angles).reshape(-1, 3)
    cross_cmm = _cross_unit(cmm_angles).reshape(-1, 3)
    # a plate shifted, turned; a table shifted, turned; an axis shifted, turned; larger and smaller
    space[translation, 0:3], space[plate, 0:3] = turn, -np.tile(identity, (len(ball_angles), 1))
    space[rotation, 3:6], space[plate, 3:6] = turn, -cross_ball
    space[translation, 6:9], space[cmm, 6:9] = constant, -all_cmm
    space[rotation, 9:12], space[cmm, 9:12] = constant, -cross_cmm
    space[axis_shift, 12:15], space[cmm, 12:15] = identity, -all_cmm
    space[axis_rotation, 15:18], space[cmm, 15:18] = identity, -cross_cmm
    space[plate, 18] = -rotation_about_z(ball_angles)[:, :, 0].ravel()
    space[cmm, 18] = rotation_about_z(cmm_angles)[:, :, 0].ravel()
    return space


def unpack(problem: BallPlateProblem, vector: Floats) -> PlateParameters:
    """Split a vector (P,) of unknowns (or of their standard deviations) into its parts."""
    parts = {field: vector[own].reshape(-1, 3) for field, own in blocks(problem).items()}
    return PlateParameters(
        plate=parts["plate"],
        cmm=parts["cmm"],
        rotation=parts["rotation"] / problem.radius,
        translation=parts["translation"],
        axis_rotation=parts["axis_rotation"][0] / problem.radius,
        axis_shift=parts["axis_shift"][0],
    )


def covariance_of(
    problem: BallPlateProblem, covariance: Floats, first: str, second: str
) -> Floats:
    """Return the covariance (M, M) of two components from that of the unknowns (P, P)."""
    rows, length = component_places(problem, first)
    columns, other = component_places(problem, second)
    return np.asarray(covariance[np.ix_(rows, columns)] * (1.0 / length / other))


def residual_cofactor(problem: BallPlateProblem, covariance: Floats) -> Floats:
    """Return the unit covariance (n, 3, 3) of the residuals from that of the unknowns (P, P)."""
    coefficients, columns = local_design(problem)
    local = covariance[columns[:, :, None], columns[:, None, :]]
    fitted = coefficients @ local @ coefficients.transpose(0, 2, 1)
    cofactor: Floats = (problem.noise_unit**2)[:, :, None] * np.eye(3) - fitted
    return cofactor
