"""The least squares of any set of centres: gaps, reduced CMM positions, unequal weights.

The table's six unknowns c_i, d_i at a position only meet the centres measured there: they are
eliminated position by position (6 x 6), which leaves a system in plate, CMM and axis only. It is
solved in the gauge of smallest norm (the 19 invisible directions are known in closed form) and
then moved along these directions to the constraints of Eq. 15 to 19. Result and covariances equal
the dense form (Eq. 20, 21).

n rows, P unknowns, M table positions in use.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_array

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, PlateParameters
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.separability import require_balls

MAX_UNKNOWNS = 6000
"""Largest covariance matrix that is set up in memory (P x P, 288 MB)."""
CONDITION_LIMIT = 1e-9
"""Smallest accepted squared pivot of the reduced system, relative to its mean diagonal."""


@dataclass(frozen=True, eq=False)
class LinearView:
    """The linear model at its solution, in units of the rows' standard deviations.

    ``design`` (3 n, P), sparse, rows divided by ``std`` (3 n,), m, or 1 where there is none;
    ``covariance`` (P, P) of the unknowns in the gauge of smallest norm; ``table`` (6 M, P) takes
    its rows to the six deviations, in the order of ``COMPONENTS``, M values each, m and rad.
    """

    design: csr_array
    std: Floats
    covariance: Floats
    table: Floats


def linear_view(problem: BallPlateProblem) -> LinearView:
    """Return the linear model of any set of centres; raises what :class:`GeneralFit` does."""
    system = GeneralFit(problem)
    covariance = system.shortest_covariance()
    spread = system.to_constraints @ covariance
    places = (model.component_places(problem, name) for name in COMPONENTS)
    table = np.concatenate([spread[own] / length for own, length in places])
    n, width = system.columns.shape
    rows = np.repeat(np.arange(3 * n), width)
    columns = np.repeat(system.columns, 3, axis=0).ravel()
    std = problem.noise_unit
    whitened = (system.local / std[:, :, None]).ravel()
    design = csr_array((whitened, (rows, columns)), shape=(3 * n, len(covariance)))
    return LinearView(design, std.ravel(), covariance, table)


def table_gain(problem: BallPlateProblem) -> Floats:
    """Return d deviations / d centres (6 M, 3 n) of the linear model.

    Rows: the components in the order of ``COMPONENTS``, M values each, in metres and radians;
    columns: the coordinates of the rows of ``problem``, metres.
    """
    view = linear_view(problem)
    return np.asarray((view.design @ view.table.T).T / view.std, dtype=np.float64)


class GeneralFit(LinearFit):
    """Any set of centres: normal equations after the table's unknowns are gone.

    Raises ObservabilityError when a table position has too few balls, when the centres do not
    determine all parameters, or when the problem is too large for this way.
    """

    way = "general"

    def __init__(self, problem: BallPlateProblem) -> None:
        _check(problem)
        super().__init__(problem)
        self.local, self.columns = model.local_design(problem)
        # weights near 1 keep the normal matrix well scaled; covariances are multiplied by ``unit``
        typical = float(np.median(problem.noise_unit))
        self.weight, self.unit = (typical / problem.noise_unit) ** 2, typical**2
        # Local columns: a, b, c, d, u, v of three each; the rest is a, b, u, v.
        self.table = self.local[:, :, 6:12]
        self.rest = np.concatenate([self.local[:, :, :6], self.local[:, :, 12:]], axis=2)
        self.rest_columns, self.rest_index, self.table_position = _places(problem, self.columns)
        self._eliminate()

    def _eliminate(self) -> None:
        """Set up and factor the reduced normal matrix; ``back`` brings its solution to the table.

        With ``own`` the 6 x 6 blocks of the table and ``mixed`` what couples them to the rest, it
        is the Schur complement rest - mixed' own^-1 mixed.
        """
        problem, n_rest = self.problem, len(self.rest_index)
        turned = len(problem.table_positions)
        weighted = self.weight[:, :, None] * self.table
        own = np.zeros((turned, 6, 6))
        np.add.at(own, problem.table_index, weighted.swapaxes(1, 2) @ self.table)
        self.own_inverse = np.linalg.inv(own)
        mixed = np.zeros((turned, 6, n_rest))
        cross = weighted.swapaxes(1, 2) @ self.rest
        where = (problem.table_index[:, None, None], np.arange(6)[None, :, None])
        np.add.at(mixed, (*where, self.rest_columns[:, None, :]), cross)
        normal = np.zeros((n_rest, n_rest))
        local = (self.weight[:, :, None] * self.rest).swapaxes(1, 2) @ self.rest
        np.add.at(normal, (self.rest_columns[:, :, None], self.rest_columns[:, None, :]), local)
        self.back = (self.own_inverse @ mixed).reshape(6 * turned, n_rest)
        normal -= mixed.reshape(6 * turned, n_rest).T @ self.back
        invisible = model.null_space(problem)
        self.to_constraints = _to_constraints(problem, invisible)
        # weight on the invisible directions makes the matrix regular and the solution the shortest
        gauge, _ = np.linalg.qr(invisible[self.rest_index])
        size = np.trace(normal) / n_rest
        self.factor = _factor(normal + size * gauge @ gauge.T, size)

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""
        vector = self._shortest(observed)
        vector += self._shortest(observed - self._computed(vector))  # iterative refinement
        vector = self.to_constraints @ vector
        return model.unpack(self.problem, vector), observed - self._computed(vector)

    @cached_property
    def _covariance(self) -> Floats:
        return np.asarray(self.to_constraints @ self.shortest_covariance() @ self.to_constraints.T)

    @property
    def unit_std(self) -> PlateParameters:
        """The standard deviations of all parameters."""
        return model.unpack(self.problem, np.sqrt(np.maximum(np.diag(self._covariance), 0.0)))

    def unit_covariance(self, first: str, second: str) -> Floats:
        """Return the covariance (M, M) of two of the table's components."""
        return model.covariance_of(self.problem, self._covariance, first, second)

    def cofactor(self) -> Floats:
        """Return the covariance (n, 3, 3) of the residuals."""
        return model.residual_cofactor(self.problem, self._covariance)

    def _shortest(self, observed: Floats) -> Floats:
        """Return the unknowns (P,) for observations (n, 3), in the gauge of smallest norm."""
        problem = self.problem
        weighted = self.weight * observed
        table = np.zeros((len(problem.table_positions), 6))
        np.add.at(table, problem.table_index, np.einsum("nij,ni->nj", self.table, weighted))
        rest = np.zeros(len(self.rest_index))
        np.add.at(rest, self.rest_columns, np.einsum("nij,ni->nj", self.rest, weighted))
        unknown = cho_solve(self.factor, rest - self.back.T @ table.ravel())
        own = (self.own_inverse @ table[:, :, None]).ravel() - self.back @ unknown
        vector = np.empty(len(self.to_constraints))
        vector[self.rest_index] = unknown
        vector[self.table_position] = own
        return vector

    def _computed(self, vector: Floats) -> Floats:
        """Return the deviations (n, 3) that the unknowns (P,) cause."""
        fitted: Floats = np.einsum("nij,nj->ni", self.local, vector[self.columns])
        return fitted

    def shortest_covariance(self) -> Floats:
        """Return the covariance (P, P) of the unknowns in the same gauge, block by block."""
        n_rest, turned = len(self.rest_index), len(self.problem.table_positions)
        rest = cho_solve(self.factor, np.eye(n_rest))
        mixed = -self.back @ rest
        own = -mixed @ self.back.T
        blocks = own.reshape(turned, 6, turned, 6)
        every = np.arange(turned)
        blocks[every, :, every, :] += self.own_inverse
        at_rest, at_table = self.rest_index, self.table_position
        covariance = np.empty((len(self.to_constraints),) * 2)
        covariance[np.ix_(at_rest, at_rest)] = rest
        covariance[np.ix_(at_table, at_rest)] = mixed
        covariance[np.ix_(at_rest, at_table)] = mixed.T
        covariance[np.ix_(at_table, at_table)] = own
        covariance *= self.unit
        return covariance


def _places(problem: BallPlateProblem, columns: Ints) -> tuple[Ints, Ints, Ints]:
    """Return where a, b, u, v of every row stand among themselves, and in the full vector.

    And where c_i, d_i stand in it, position by position, (6 M,).
    """
    at = model.blocks(problem)
    first, last = at["rotation"].start, at["translation"].stop
    every = np.arange(model.n_unknowns(problem))
    rest = np.concatenate([every[:first], every[last:]])
    local = np.concatenate([columns[:, :6], columns[:, 12:]], axis=1)
    table = [every[at[field]].reshape(-1, 3) for field in ("rotation", "translation")]
    return np.searchsorted(rest, local), rest, np.concatenate(table, axis=1).ravel()


def _factor(normal: Floats, size: float) -> tuple[Floats, bool]:
    try:
        factor: tuple[Floats, bool] = cho_factor(normal, lower=True)
    except LinAlgError:
        raise ObservabilityError(_NOT_DETERMINED) from None
    if np.min(np.abs(np.diag(factor[0]))) ** 2 < CONDITION_LIMIT * size:
        raise ObservabilityError(_NOT_DETERMINED)
    return factor


_NOT_DETERMINED = (
    "the centres do not determine all errors of table, plate and CMM: measure more balls or "
    "CMM positions, or fill the gaps"
)


def _to_constraints(problem: BallPlateProblem, invisible: Floats) -> Floats:
    """Return the projector (P, P) along the invisible directions H onto the constraints G.

    It is 1 - H (G H)^-1 G.
    """
    constraints = model.constraint_matrix(problem)
    step = np.linalg.solve(constraints @ invisible, constraints)
    return np.eye(len(invisible)) - invisible @ step


def _check(problem: BallPlateProblem) -> None:
    unknowns = model.n_unknowns(problem)
    if unknowns > MAX_UNKNOWNS:
        raise ObservabilityError(
            f"{unknowns} unknowns: incomplete or weighted data are solved up to {MAX_UNKNOWNS}; "
            "use a coarser grid, or measure the missing centres (complete data have no limit)"
        )
    require_balls(problem)
