"""The least squares of a plate: which way solves it, a drift estimated along, the exact model.

Complete data with equal weights are solved harmonic by harmonic (:mod:`.spectral`), also with a
few gaps, for which that is corrected exactly; all others by elimination
(:mod:`.general_least_squares`). One linear model, one answer. A drift of the CMM's origin is
added as a few further unknowns. The linear fit is then repeated until it solves the exact model

    m = v + R_u [ E(c_i) B_i E_z(u_z) (p_j + a_j) + d_i + b_k ],      i = k - j (mod N)

where E(c) is the rotation about c by |c| and R_u the shortest rotation that takes z to the axis.
What this has beyond Eq. 12 are products of small quantities: the tilt of the axis with the plate's
place, the table's rotations with the plate's place. Deviations, plate and CMM errors live in the
frame of the fitted axis, and obey Eq. 15 to 19 there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.general_least_squares import MAX_UNKNOWNS, GeneralFit
from rotcal_ros.methods.ball_plate.solver.model import (
    LinearFit,
    OriginDrift,
    PlateParameters,
    Solution,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle
from rotcal_ros.methods.ball_plate.solver.separability import require_balls
from rotcal_ros.methods.ball_plate.solver.spectral import ClosedFormFit, SpectralFit

FEW_GAPS = 20
"""Gaps up to which correcting the spectral solution is quicker than the elimination."""
MANY_GAPS = 300
"""Gaps up to which it is also done where the elimination does not fit into memory."""
DETERMINED = 1e-7
"""Smallest accepted eigenvalue of the residual cofactor at the gaps."""
VISIBLE = 0.01
"""Part of a drift's sum of squares that must be left in the residuals to estimate it."""
SETTLED = 3e-4
"""Largest change of any combination of parameters, in its standard deviations, left undone."""
MOST_ROUNDS = 60


def solved(problem: BallPlateProblem) -> tuple[LinearFit, Solution]:
    """Return the factored linear model and the solution of the exact one; a drift is estimated.

    The linear fit is iterated until the products that it neglects are gone. Raises
    ObservabilityError when the centres do not determine all parameters, DataError when plate or
    frame are too far off for the iteration to settle.
    """
    linear = factored_with_drift(problem)
    settled = linear.settled() if isinstance(linear, WithDrift) else _settled(problem, linear)
    return linear, settled


def factored_with_drift(problem: BallPlateProblem) -> LinearFit:
    """Factor the model of Eq. 12 and the drift that is to be estimated; as :func:`factored`."""
    return WithDrift(problem) if problem.drift else factored(problem)


def factored(problem: BallPlateProblem) -> LinearFit:
    """Factor the model of Eq. 12, without a drift, the quickest way.

    Raises ObservabilityError when the centres do not determine all parameters, PlanError where
    the closed form is asked for and there are fewer balls than positions. Of centres with gaps,
    or with weights, it does not exist: the least squares take its place.
    """
    axes = _same_everywhere(problem)
    if axes is not None:
        return _Scaled(problem, axes)
    if problem.complete and problem.std is None:
        return ClosedFormFit(problem) if problem.closed_form else SpectralFit(problem)
    gaps = _few_gaps(problem)
    return GeneralFit(problem) if gaps is None else WithGaps(problem, gaps)


def _same_everywhere(problem: BallPlateProblem) -> Floats | None:
    """Return the standard deviations (3,) of all rows when x and y have the same one.

    The linear model keeps z apart from x and y, so such weights change no estimate.
    """
    if problem.std is None or not problem.weighed_alike:
        return None
    axes: Floats = problem.std[0]
    return axes if axes[0] == axes[1] else None


class _Scaled(LinearFit):
    """The fit of equal weights, whose covariances belong to noise of ``axes`` (3,)."""

    def __init__(self, problem: BallPlateProblem, axes: Floats) -> None:
        super().__init__(problem)
        self.equal, self.axes = factored(replace(problem, std=None)), axes
        self.way = self.equal.way

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        return self.equal.fit(observed)

    @property
    def unit_std(self) -> PlateParameters:
        return model.scaled(self.equal.unit_std, self.axes)

    def unit_covariance(self, first: str, second: str) -> Floats:
        scale = model.of_component(self.axes, first) * model.of_component(self.axes, second)
        return np.asarray(scale * self.equal.unit_covariance(first, second))

    def cofactor(self) -> Floats:
        return np.asarray(self.equal.cofactor() * np.outer(self.axes, self.axes))


def _few_gaps(problem: BallPlateProblem) -> Ints | None:
    """Return the missing cells when correcting for them is the better way, else None."""
    if problem.std is not None or problem.bidirectional:
        return None
    if min(len(problem.table_positions), len(problem.cmm_positions)) < problem.grid:
        return None  # a filled grid would have unknowns that no centre sees
    gaps = gap_cells(problem)
    large = model.n_unknowns(problem) > MAX_UNKNOWNS
    if gaps is None or len(gaps) > (MANY_GAPS if large else FEW_GAPS):
        return None
    require_balls(problem)
    return gaps


def gap_cells(problem: BallPlateProblem) -> Ints | None:
    """Return the missing cells (place in the complete canonical order), None if some repeat."""
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cells = ball * problem.grid + problem.position
    if len(np.unique(cells)) < len(cells):
        return None
    return np.setdiff1d(np.arange(len(problem.balls) * problem.grid), cells)


class _Bordered(LinearFit):
    """A ``plain`` fit with m further unknowns, which its residuals determine.

    A unit of each moves the ``parameters`` (m as last axis) and the residuals, ``remains``
    (n, 3, m); ``inverse`` (m, m) is the unit covariance of the unknowns.
    """

    plain: LinearFit
    parameters: PlateParameters
    remains: Floats
    inverse: Floats

    @property
    def unit_std(self) -> PlateParameters:
        def std(own: Floats, moved: Floats) -> Floats:
            added = np.einsum("...i,ij,...j->...", moved, self.inverse, moved)
            return np.asarray(np.sqrt(own**2 + added))

        return self.plain.unit_std.merged(std, self.parameters)

    def unit_covariance(self, first: str, second: str) -> Floats:
        left, right = self.parameters.component(first), self.parameters.component(second)
        added: Floats = left @ self.inverse @ right.T
        return self.plain.unit_covariance(first, second) + added

    def cofactor(self) -> Floats:
        taken: Floats = self.remains @ self.inverse @ self.remains.swapaxes(1, 2)
        return self._plain_cofactor() - taken

    def _plain_cofactor(self) -> Floats:
        return self.plain.cofactor()


class WithGaps(_Bordered):
    """An equally weighted problem of which only the cells ``gaps`` (m,) are missing.

    A missing centre is filled with the value that gives it a zero residual; the fit of the filled
    data is then the least squares fit of the others. The values follow from the residual cofactor
    at the gaps, a 3m x 3m matrix, which corrects the covariances too. Raises ObservabilityError
    when the remaining centres do not determine all parameters.
    """

    way = "spectral with gaps"

    def __init__(self, problem: BallPlateProblem, gaps: Ints) -> None:
        super().__init__(problem)
        grid, balls = problem.grid, problem.balls
        table, ball = np.tile(np.arange(grid), len(balls)), np.repeat(balls, grid)
        self.gaps, self.measured = gaps, np.setdiff1d(np.arange(len(table)), gaps)
        self.plain = SpectralFit(BallPlateProblem.nominal(grid, problem.radius, table, ball))
        units = np.zeros((len(table), 3, len(gaps), 3))
        units[gaps[:, None], np.arange(3), np.arange(len(gaps))[:, None], np.arange(3)] = 1.0
        # a residual at the gaps per unit deviation there: the cofactor
        caused = self.plain.responses(units.reshape(len(table), 3, -1))
        self.parameters, self.remains, at_gaps = caused
        if np.linalg.eigvalsh(at_gaps)[0] < DETERMINED:
            raise ObservabilityError(
                "without the missing or rejected centres not all errors of table, plate and CMM "
                "are determined: measure more balls at the table positions of the gaps"
            )
        self.remains = self.remains[self.measured]
        self.inverse = np.asarray(np.linalg.inv(at_gaps), dtype=np.float64)

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""
        filled = np.zeros((len(self.measured) + len(self.gaps), 3))
        filled[self.measured] = observed
        _, start = self.plain.fit(filled)
        filled[self.gaps] = -(self.inverse @ start[self.gaps].ravel()).reshape(-1, 3)
        estimate, residuals = self.plain.fit(filled)
        return estimate, residuals[self.measured]

    def _plain_cofactor(self) -> Floats:
        return self.plain.cofactor()[self.measured]


def drift_columns(run_time: Floats, degree: int) -> Floats:
    """Return the displacement (n, 3, 3 degree) of centres by a drift of 1 m over the run.

    ``run_time`` runs from -0.5 to 0.5. The linear part comes first, then the bow: 1 m more at
    both ends than in the middle.
    """
    shapes = np.stack([run_time, 4.0 * run_time**2], axis=1)[:, :degree]
    columns = shapes[:, None, :, None] * np.eye(3)[:, None, :]
    return columns.reshape(len(run_time), 3, 3 * degree)


def drifted(
    problem: BallPlateProblem, reference: BallPlateProblem, drift: OriginDrift | None
) -> Floats:
    """Return where an estimated drift moved the rows (n, 3); ``reference`` has its time."""
    if drift is None:
        return np.zeros_like(problem.centres)
    columns = drift_columns(problem.run_time_on(reference), len(drift.amount))
    moved: Floats = columns @ drift.amount.ravel()
    return moved


def drift_seen(problem: BallPlateProblem, columns: Floats, information: Floats) -> float:
    """Return the part of a drift's squares that the residuals keep, in the worst direction.

    ``columns`` (n, 3, m) displace the centres, ``information`` (m, m) is what the fit leaves of
    them. A constant part counts for nothing: the pose of the axis takes it.
    """
    centred = columns - columns.mean(axis=0)
    total = np.einsum("nia,ni,nia->a", centred, problem.weights, centred)
    scale = 1.0 / np.sqrt(total)
    return float(np.linalg.eigvalsh(information * np.outer(scale, scale))[0])


class WithDrift(_Bordered):
    """The fit of a problem with its drift.

    With E the columns of the drift, M the projector to the residuals and W the weights the amounts
    are (E' W M E)^-1 E' W M y; everything else moves by what they cause. Raises ObservabilityError
    where the residuals keep too little of a drift.
    """

    def __init__(self, problem: BallPlateProblem) -> None:
        super().__init__(problem)
        self.plain = factored(problem)
        self.columns = drift_columns(problem.run_time, problem.drift)  # (n, 3, m)
        self.dof -= self.columns.shape[2]
        self.way = f"{self.plain.way} with drift"
        self.weighted = problem.weights[:, :, None] * self.columns
        self.parameters, self.remains, information = self.plain.responses(self.columns)
        seen = drift_seen(problem, self.columns, information)
        if seen < VISIBLE:
            raise ObservabilityError(
                "a drift cannot be separated from errors of the table and the CMM in this order "
                f"of measurement: the residuals keep {max(seen, 0.0):.2g} of it, {VISIBLE:g} "
                "are needed; measure in the order interleaved, or leave solver.drift at none"
            )
        self.inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)

    def amount(self, residuals: Floats) -> Floats:
        """Return how much (m,) of each column residuals (n, 3) without drift contain."""
        found: Floats = self.inverse @ np.einsum("nia,ni->a", self.weighted, residuals)
        return found

    def fit(self, observed: Floats) -> tuple[PlateParameters, Floats]:
        """Return parameters and residuals (n, 3) of deviations (n, 3) of the rows, metres."""
        found, residuals = self.plain.fit(observed)
        amount = self.amount(residuals)
        found = found.merged(lambda own, moved: own - moved @ amount, self.parameters)
        return found, residuals - self.remains @ amount

    def settled(self) -> Solution:
        """Return the solution of the exact model.

        The amount follows from the linear model, and twice more from what is left of the exact
        one: the products with the pose of the axis are gone after that.
        """
        amount = self.amount(self.plain.fit(self.problem.deviations)[1])
        for _ in range(2):
            rest = replace(self.problem, centres=self.problem.centres - self.columns @ amount)
            solution = _settled(rest, self.plain)
            amount = amount + self.amount(solution.residuals)
        found = OriginDrift(amount.reshape(-1, 3), self.inverse)
        return replace(self.solution(solution.estimate, solution.residuals), drift=found)


def _settled(problem: BallPlateProblem, linear: LinearFit) -> Solution:
    """Return the least squares solution of the exact model.

    The linear fit takes the misclosure of the exact model again and again, its design frozen at
    the nominal places, until nothing is left to take. The length of what one round neglects, in
    standard deviations of a centre, is a bound on the change of every linear combination of the
    parameters in the next one, in the standard deviations of that combination: below SETTLED the
    iteration ends. Well aligned data pass this test on the linear solution. Raises DataError when
    the iteration does not settle.
    """
    found, residuals = linear.fit(problem.deviations)
    if _neglected(problem, found) < _limit(problem, residuals):
        return linear.solution(found, residuals)
    pose = _Pose().moved(found)
    for _ in range(MOST_ROUNDS):
        misclosure = _misclosure(problem, found, pose)
        if _length(problem, misclosure - residuals) < _limit(problem, misclosure):
            residuals = misclosure @ pose.frame.T
            return linear.solution(pose.in_machine_axes(found), residuals)
        step, residuals = linear.fit(misclosure)
        found = found.merged(np.add, step)
        pose = pose.moved(step)
    raise DataError(
        f"the fit does not settle in {MOST_ROUNDS} rounds, plate and axis are too far off for "
        "these balls: centre the plate better, align the CMM's frame with the axis"
    )


def computed(
    problem: BallPlateProblem, found: PlateParameters, plate: Floats, cmm: Floats
) -> Floats:
    """Return the centres (n, 3) that the exact model predicts for the rows of ``problem``.

    ``plate`` and ``cmm`` (n, 3) are the errors of ball and CMM position of each row; the table
    positions in use must be those that ``found`` belongs to.
    """
    pose = _Pose.of(found)
    yaw = rotation_about_z(found.axis_rotation[2])
    centres: Floats = _there(problem, found, plate, cmm, yaw) @ (pose.frame @ yaw.T).T
    return centres + pose.origin


def _there(
    problem: BallPlateProblem, found: PlateParameters, plate: Floats, cmm: Floats, yaw: Floats
) -> Floats:
    """Return the centres (n, 3) in the frame of the axis, of a plate turned by ``yaw`` (3, 3)."""
    places = problem.radius * on_circle(problem.angles[problem.ball_step]) + plate
    table = rotation_from_vector(found.rotation * [1.0, 1.0, 0.0])
    turn = problem.angles[problem.table_positions] + found.rotation[:, 2]
    table = table @ rotation_about_z(turn) @ yaw
    there = np.einsum("nij,nj->ni", table[problem.table_index], places)
    there += found.translation[problem.table_index] + cmm
    return np.asarray(there)


@dataclass(frozen=True)
class _Pose:
    """Frame of axis and plate: ``frame`` (3, 3) holds its axes as columns, ``origin`` (3,)."""

    frame: Floats = field(default_factory=lambda: np.eye(3))
    origin: Floats = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, found: PlateParameters) -> _Pose:
        """Return the pose that the parameters of a solution state."""
        tilt = rotation_from_vector(found.axis_rotation * [1.0, 1.0, 0.0])
        return cls(tilt @ rotation_about_z(found.axis_rotation[2]), found.axis_shift)

    def moved(self, step: PlateParameters) -> _Pose:
        """Return the pose after the small motion of a step, given in this frame."""
        turned = self.frame @ rotation_from_vector(step.axis_rotation)
        return _Pose(turned, self.origin + self.frame @ step.axis_shift)

    def in_machine_axes(self, found: PlateParameters) -> PlateParameters:
        """Return parameters with the pose, their vectors along x and y of the machine.

        The frame is tilt times a turn about the axis; the latter is the plate's, not the axis's.
        """
        axis = self.frame[:, 2]
        sine = float(np.hypot(axis[0], axis[1]))
        size = np.arctan2(sine, axis[2]) / sine if sine > 0.0 else 1.0  # angle over its sine
        tilt = size * np.array([-axis[1], axis[0], 0.0])
        turn = rotation_from_vector(tilt).T @ self.frame
        yaw = np.array([0.0, 0.0, np.arctan2(turn[1, 0], turn[0, 0])])
        vectors = {f: getattr(found, f) @ turn.T for f in ("cmm", "rotation", "translation")}
        return PlateParameters(
            plate=found.plate, axis_rotation=tilt + yaw, axis_shift=self.origin, **vectors
        )


def _misclosure(problem: BallPlateProblem, found: PlateParameters, pose: _Pose) -> Floats:
    """Return observed - computed (n, 3) in the frame of axis and plate."""
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cmm = np.searchsorted(problem.cmm_positions, problem.cmm_index)
    there = _there(problem, found, found.plate[ball], found.cmm[cmm], np.eye(3))
    misclosure: Floats = (problem.centres - pose.origin) @ pose.frame - there
    return misclosure


def _neglected(problem: BallPlateProblem, found: PlateParameters) -> float:
    """Return a bound on the length of all products that the linear model neglects.

    In units of the smallest standard deviation where the rows have their own. The length goes over
    all rows together, so norms multiply: every ball meets every rotation.
    """
    n_balls, n = len(problem.balls), len(problem.centres)
    rotation, plate = np.linalg.norm(found.rotation), np.linalg.norm(found.plate)
    largest = float(np.max(np.abs(found.rotation)))
    pose = float(np.linalg.norm(found.axis_rotation))
    around = problem.radius * np.sqrt(n_balls) * rotation  # how far the rotations move the balls
    moved = around + np.sqrt(problem.grid) * plate
    moved += np.sqrt(n_balls) * (np.linalg.norm(found.translation) + np.linalg.norm(found.cmm))
    bound = rotation * plate + largest * around  # the latter for the rotations' second order
    bound += pose * moved + 0.5 * pose**2 * problem.radius * np.sqrt(n)
    return float(bound) / float(problem.noise_unit.min())


def _limit(problem: BallPlateProblem, residuals: Floats) -> float:
    """Return the length (n, 3) differences may have: in metres, or in units of ``std``."""
    total = model.weighted_square_sum(problem, residuals)
    sigma = np.sqrt(total / max(model.degrees_of_freedom(problem), 1))
    rounding = np.sqrt(model.rounding_variance(problem) * residuals.size)
    return float(max(SETTLED * sigma, rounding))


def _length(problem: BallPlateProblem, differences: Floats) -> float:
    """Return the length of differences (n, 3), in metres, or in units of ``std``."""
    return float(np.sqrt(model.weighted_square_sum(problem, differences)))
