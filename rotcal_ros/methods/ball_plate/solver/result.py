"""The ball plate method from a problem to the result that all methods share, and trials of it.

The engine solves the model of :mod:`.plate_model` and says what is wrong with it. Here stands
what it cannot know: which rows are worth fitting at all, groups of table positions that no ball
connects, stated allowances, the closed form, and the words for a plate that warms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust import engine
from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.distributions import f_sf, normal_isf
from rotcal_ros.adjust.engine import Adjusted, FoundEffect, Trials
from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.errors import DataError, ObservabilityError, PlanError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import TOLERABLE, Protection
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import FreeDirection, Rejection, Result
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.added_errors import with_errors
from rotcal_ros.methods.ball_plate.settings import kelvin
from rotcal_ros.methods.ball_plate.solver.closed_form import curves_of_groups
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.plate_model import (
    IN_PLANE,
    PlateRows,
    curve_model,
    drift_columns,
    plate_model,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_step
from rotcal_ros.methods.ball_plate.solver.screening import RADIUS_TOLERANCE, screen
from rotcal_ros.methods.ball_plate.solver.separability import (
    MIN_BALLS,
    balls_at_positions,
    common_divisor,
    require_balls,
    require_separable,
    separability,
)

SCATTER_UNEQUALLY: Final = noted(
    "the centres scatter unequally, by {0} um along x, y and z: each axis counts by its own "
    "noise; state solver.sigma_axes_m, or find out why"
)
OWN_ZEROS: Final = noted("The offset between {0} is not measured: each group has its own zero")
FEW_BALLS_LEFT: Final = noted(
    "{0} of {1} table positions have fewer than {2} balls and are left out of the result: {3}"
)
PLATE_GREW: Final = noted(
    "the plate {0} by {1:.3g} um/m over the run, {2}: let plate and machine settle, or measure "
    "in less time"
)
ORIGIN_DRIFTS: Final = noted(
    "the origin of the CMM drifts by ({0}) um over the run in x, y, z; it is estimated and taken "
    "off"
)
NOT_CLOSED_FORM: Final = noted(
    "not all centres are left with equal weights, which the closed form needs: the least squares "
    "took its place (they are the same where both exist)"
)

METHOD: Final = "ball_plate"
LIMITS: Final = Limits(rejected_share=0.02, gathered_share=3e-4)
"""Dirt on one ball of fifty is nothing unusual; on two of twelve at one position it is."""
AXIS_SIGNIFICANCE: Final = 0.001
"""Level of the test whether the centres scatter alike along x and y, where it is doubted."""
APART: Final = 0.05
"""The same from which on each axis counts by its own noise: it is no loss where they are alike."""
MATTERS: Final = 1.1
"""Times that one of them scatters as much as the other, below which it makes no difference."""
SIGNS: Final = 8
"""Sets of random signs that show what the residuals along an axis feel of each."""
NO_NOISE: Final = 1e-9
"""Variance along an axis, of that along the other, that is none."""
UNEQUAL: Final = 3.0
"""Times that centres may scatter along one axis as much as along another."""
VISIBLE: Final = 0.01
"""Part of a drift's sum of squares that must be left in the residuals to estimate it."""
MOST_OPEN: Final = 0.25
"""Part of the table positions that may be left out for lack of balls."""
FEW_BALLS: Final = 2 * MIN_BALLS
"""Balls at a table position below which dirt may leave its errors open."""
PLAUSIBLE_K: Final = 20.0
"""Kelvin from which on a growth is not laid to the plate's temperature."""
PAIRS: Final = (("EXC", "EYC"), ("EAC", "EBC"))
"""Components that a plate shifted or tilted on the table takes back together."""


@dataclass(frozen=True)
class PlateSolution:
    """A solved ``problem``: what was ``fitted`` of it, and what the engine ``found``.

    ``unusable``: the rows that were not fitted at all; ``alike``: how probably x and y, which
    count apart, scatter as unequally by chance; None: they count together.
    """

    problem: BallPlateProblem
    fitted: BallPlateProblem
    layout: PlateLayout
    found: Adjusted
    unusable: tuple[Rejection, ...]
    alike: float | None = None

    @property
    def by_axis(self) -> bool:
        """Whether x and y have noise of their own."""
        return self.alike is not None

    @cached_property
    def rows(self) -> PlateRows:
        """The rows of the model."""
        return PlateRows(self.layout, by_axis=self.by_axis)

    @property
    def table_positions(self) -> Ints:
        """The table positions that could be solved, ascending, (M,); the others were left out."""
        return self.fitted.table_positions

    @property
    def noisy(self) -> bool:
        """Whether centres show any noise, or it was stated."""
        model = self.found.model
        return not model.unstated or bool(self.found.fit.std.max() > model.least)

    @property
    def parts(self) -> dict[str, slice]:
        """Which outputs are the deviations of which component."""
        count = self.layout.counts[0]
        return {name: slice(k * count, (k + 1) * count) for k, name in enumerate(COMPONENTS)}

    @cached_property
    def members(self) -> Floats:
        """1 for the table positions (M,) of each group and 0 for the others, (g, M)."""
        group = self.layout.group[0][np.argsort(self.layout.table_positions)]
        return np.asarray(group == np.arange(self.layout.groups)[:, None], dtype=np.float64)

    @cached_property
    def allowed(self) -> Floats:
        """What stated allowances do to the outputs, (o, k) independent errors, uniform each."""
        problem, found = self.problem, self.found
        columns = [np.zeros((len(found.value), 0))]
        if problem.drift_allowance and not problem.drift:
            rows = self.rows
            drift = rows.of(drift_columns(rows.time, 1)) / found.fit.std[:, None]
            moved = found.fit.moved(drift * found.fit.used[:, None])[: len(found.value)]
            columns.append(problem.drift_allowance / np.sqrt(3.0) * moved)
        if problem.group_allowance and self.layout.groups > 1:
            columns.append(self._between_groups())
        return np.hstack(columns)

    def _between_groups(self) -> Floats:
        """Return what the allowance between any two groups does to the outputs (o, k).

        Constant and turning part differ by no more than the allowance, m on the circle of the
        balls, with equal probability for all values in between.
        """
        problem, parts = self.problem, self.parts
        size = problem.group_allowance / np.sqrt(6.0)  # either of two has half of size^2 / 3
        found = []
        for own in self.members - self.members.mean(axis=1, keepdims=True):
            for direction in _directions(own, problem.angles[self.table_positions]):
                column = np.zeros(len(self.found.value))
                for name, values in direction.items():
                    column[parts[name]] = values / (problem.radius if name in ROTATIONS else 1.0)
                found.append(size * column)
        return np.stack(found, axis=1)

    @cached_property
    def value(self) -> Floats:
        """The deviations (6 M,): by the closed form where that was asked for, and exists."""
        if not self.problem.closed_form or not self.closes:
            return self.found.value
        fit, rows = self.found.fit, self.rows
        first = self.layout.unknowns
        moved = fit.jacobian.times(np.where(np.arange(len(fit.x)) < first, 0.0, fit.x))
        off = np.swapaxes(rows.frame, 1, 2) @ moved.reshape(-1, 3, 1)
        centres = self.fitted.centres.copy()
        centres[self.layout.row] -= off[:, :, 0]
        return curves_of_groups(replace(self.fitted, centres=centres), self.layout.groups)

    @property
    def closes(self) -> bool:
        """Whether the closed form exists: all centres of all balls once, and with one weight."""
        table, _, ball = self.layout.counts
        complete = len(self.fitted.centres) == table * ball // self.layout.groups
        square = ball == table == self.problem.grid and not self.problem.bidirectional
        alike = self.fitted.weighed_alike and not self.by_axis and bool(self.found.fit.used.all())
        return square and complete and alike


def solve(problem: BallPlateProblem) -> Result:
    """Return the table's six deviations with covariances from the centres of a ball plate.

    Raises DataError for a table that is not what it says and ObservabilityError, with the
    harmonics that are lost, when balls and positions do not separate the errors.
    """
    return result_of(adjust(problem))


def adjust(problem: BallPlateProblem) -> PlateSolution:
    """Return the solution of ``problem``; raises what :func:`solve` raises."""
    fitted, unusable, layout = _prepared(problem)
    try:
        found, alike = _found(layout)
    except ObservabilityError as error:
        require_separable(fitted)  # names the harmonics, where it is the harmonics
        less = _without_dirty_position(fitted, layout.groups)
        if less is None:
            if fitted.drift:
                raise _hidden_drift(0.0) from error
            raise
        left_out, fitted, layout, (found, alike) = less
        unusable = (*unusable, *left_out)
    if fitted.drift:
        _require_visible(found, layout)
    if not found.fit.dof:
        raise DataError(
            f"{len(fitted.centres)} centres leave no redundancy: nothing can be checked; "
            "measure more balls or CMM positions"
        )
    return PlateSolution(problem, fitted, layout, found, unusable, alike)


def _found(layout: PlateLayout) -> tuple[Adjusted, float | None]:
    """Return what is found, and how probably axes are alike that count apart; None: together.

    Where it does not matter they count together, which takes a tenth of the time. An effect may
    pass for noise of one axis, and this for an effect: the more probable is believed.
    """
    found = engine.adjust(plate_model(layout), LIMITS)
    ratio, alike = _axes(layout, found)
    level = APART if found.diagnosis.noise.estimated else AXIS_SIGNIFICANCE
    if ratio < MATTERS or alike >= level:
        return found, None
    apart = engine.adjust(plate_model(layout, by_axis=True), LIMITS)
    explained = found.diagnosis.why or found.found_effects
    if explained and _improbability(found) < _improbability(apart):
        return found, None
    return apart, alike


def _improbability(found: Adjusted) -> float:
    """Return twice -ln of the probability, whatever the noise was taken for beforehand."""
    first = found.model.std[found.diagnosis.used]
    return found.diagnosis.bic + 2.0 * float(np.log(first / MICROMETRE).sum())


def _without_dirty_position(
    fitted: BallPlateProblem, groups: int
) -> tuple[list[Rejection], BallPlateProblem, PlateLayout, tuple[Adjusted, float | None]] | None:
    """Return what is found without a table position of few balls, most of which are dirty.

    None where that does not help.
    """
    count = balls_at_positions(fitted)
    for position in np.flatnonzero((count > 0) & (count < FEW_BALLS)).tolist():
        away = fitted.position == position
        why = phrase(
            "without what is far off, too few balls are left at this table position to determine "
            "its six errors: the angle is left out"
        )
        rejected = [
            Rejection(int(fitted.rows[r]), phrase("{0}: {1}", fitted.row_name(r), why))
            for r in np.flatnonzero(away).tolist()
        ]
        less = fitted.take(~away)
        layout = PlateLayout(less, groups)
        try:
            return rejected, less, layout, _found(layout)
        except ObservabilityError:
            continue
    return None


def _require_visible(found: Adjusted, layout: PlateLayout) -> None:
    """Raise ObservabilityError where the residuals keep too little of a drift to estimate it.

    A constant part counts for nothing: the pose of the axis takes it.
    """
    fit, rows = found.fit, PlateRows(layout)
    own = slice(layout.unknowns, layout.unknowns + rows.drift.shape[1])
    each = rows.drift.reshape(-1, 3, rows.drift.shape[1])
    whole = (((each - each.mean(axis=0)) ** 2).sum(axis=(0, 1))) / np.mean(fit.std) ** 2
    gain = fit.gain(own) * np.sqrt(whole)[:, None]
    seen = 1.0 / float(np.linalg.eigvalsh(gain @ gain.T)[-1])
    if seen < VISIBLE:
        raise _hidden_drift(seen)


def _hidden_drift(seen: float) -> ObservabilityError:
    return ObservabilityError(
        "a drift cannot be separated from errors of the table and the CMM in this order of "
        f"measurement: the residuals keep {seen:.2g} of it, {VISIBLE:g} are needed; measure in "
        "the order interleaved, or leave solver.drift at none"
    )


def _axes(layout: PlateLayout, found: Adjusted) -> tuple[float, float]:
    """Return how many times centres scatter along one of x and y, and how probable that is.

    Of axes that are alike. The residuals r along each have sums of squares that feel the noise of
    both, sum r_x^2 = a s_x^2 + c s_y^2; a and c are squared sums of the redundancy matrix by pairs
    of axes, and the variances have the covariance 2 [a c; c a]^-1. Random signs show them.
    """
    rows, fit = PlateRows(layout), found.fit
    if not rows.turned or len(found.model.components) != len(IN_PLANE):
        return 1.0, 1.0
    if found.model.unstated and not found.diagnosis.noise.estimated:
        return 1.0, 1.0  # there is none
    used = fit.used.reshape(-1, 3)[:, 0]
    back = np.swapaxes(rows.frame[used], 1, 2)[:, :2]

    def along(white: Floats) -> Floats:
        """Return sums of squares along x and y (2, k) of rows (3 n, k)."""
        return np.asarray(((back @ white.reshape(len(used), 3, -1)[used]) ** 2).sum(axis=0))

    signs = np.random.default_rng(0).choice((-1.0, 1.0), (len(used), 1, SIGNS))
    trials = ((rows.frame[:, :, k : k + 1] * signs).reshape(-1, SIGNS) for k in range(2))
    matrix = np.stack([along(fit.residuals_of(white)).mean(axis=1) for white in trials])
    dof = float(matrix.trace() - matrix[0, 1] - matrix[1, 0]) / 2.0
    if dof < 1.0:
        return 1.0, 1.0
    variance = np.linalg.solve(matrix, along(fit.white)[:, 0])
    ratio = float(variance.max() / max(variance.min(), NO_NOISE * variance.max()))
    return float(np.sqrt(ratio)), 2.0 * f_sf(ratio, dof, dof)


def model_of_curves(problem: BallPlateProblem, angles: Floats) -> tuple[CurveModel, Ints]:
    """Return the centres over the six deviations, and which table positions are in use.

    ``angles``, rad, are those of all table positions.
    """
    alone = replace(problem, separate_groups=False)
    fitted, _, layout = _prepared(alone, connected=False)
    return curve_model(layout, angles), fitted.table_positions


def _prepared(
    problem: BallPlateProblem, *, connected: bool = True
) -> tuple[BallPlateProblem, tuple[Rejection, ...], PlateLayout]:
    """Return the rows worth fitting, why others are not, and their layout."""
    if problem.closed_form:  # of each ball at each table position the first measurement
        order = np.argsort(problem.rows, kind="stable")
        once = order[np.unique(problem.cell[order], return_index=True)[1]]
        problem = problem.take(np.sort(once))
    whole, rejected = screen(problem)
    groups = common_divisor(whole.grid, whole.balls) if whole.separate_groups else 1
    measured = grid_step(whole.position, whole.grid) % groups
    if missing := set(range(groups)) - set(measured.tolist()):
        first = min(missing)
        raise ObservabilityError(
            f"no centre was measured at the table positions {first}, {first + groups}, ...: "
            "one group is missing altogether; measure it"
        )
    count = balls_at_positions(whole)
    poor = np.flatnonzero(count < MIN_BALLS)
    if len(poor) > MOST_OPEN * whole.n_positions:
        require_balls(whole, everywhere=True)
    away = np.isin(whole.position, poor)
    for r in np.flatnonzero(away).tolist():
        why = phrase(
            "{0}: only {1} balls are left at this table position, too few to determine its six "
            "errors: the angle is left out", whole.row_name(r), count[whole.position[r]]
        )  # fmt: skip
        rejected.append(Rejection(int(whole.rows[r]), why))
    fitted = whole.take(~away)
    layout = PlateLayout(fitted, groups)
    needed = fitted.grid // groups
    if fitted.closed_form and len(fitted.balls) < needed:
        raise PlanError(
            f"the closed form needs {needed} balls at as many table positions of a group; found "
            f"{len(fitted.balls)}"
        )
    if connected and fitted.complete and groups == 1:
        require_separable(fitted)
    return fitted, tuple(rejected), layout


def result_of(solution: PlateSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share.

    Stated allowances enlarge the covariance.
    """
    problem, layout, found = solution.fitted, solution.layout, solution.found
    rows, groups = problem.rows[layout.row], layout.groups
    result = found.result(
        METHOD,
        problem.angles[solution.table_positions],
        solution.parts,
        (problem.position[layout.row], problem.ball_step[layout.row]),
        coordinates=3,
        doubts=list(_doubts(solution)),
        protections=list(_protections(solution)),
        details=_details(solution),
    )  # fmt: skip
    rejected = (replace(r, index=int(rows[r.index])) for r in result.rejected)
    result = replace(
        result,
        deviations={name: solution.value[part] for name, part in solution.parts.items()},
        n_observations=len(solution.problem.centres),
        rejected=tuple(sorted((*solution.unusable, *rejected), key=lambda r: r.index)),
        warnings=(*_warnings(solution), *result.warnings),
        raw_data=_in_machine_axes(result.raw_data, solution),
    )
    if solution.allowed.any():
        own = {name: solution.allowed[part] for name, part in solution.parts.items()}
        result = with_errors(result, own)
    if groups == 1:
        return result.counted_from("mean")
    free = () if solution.problem.group_allowance else _free_directions(solution)
    return result.counted_from("mean of each group", free)


def trials_about(solution: PlateSolution) -> Trials:
    """Prepare Monte Carlo trials about a solution, with the noise that its result states."""
    causes = np.hstack([solution.found.trials.causes, solution.allowed])
    return replace(solution.found.trials, value=solution.value, causes=causes)


def plate_trials(problem: BallPlateProblem) -> Trials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses."""
    return trials_about(adjust(problem))


def _in_machine_axes(raw_data: RawData, solution: PlateSolution) -> RawData:
    """Return the raw data with what errors of x, y and z do, in the numbers of the rows."""
    influence, layout = raw_data.influence, solution.layout
    if influence is None:
        return raw_data
    back = solution.rows.frame[influence.rows]
    turned = {
        name: np.einsum("mri,rij->mrj", by.reshape(len(by), -1, 3), back).reshape(by.shape)
        for name, by in influence.deviations.items()
    }
    rows = solution.fitted.rows[layout.row[influence.rows]]
    return replace(raw_data, influence=replace(influence, rows=rows, deviations=turned))


def _directions(own: Floats, angles: Floats) -> Iterator[dict[str, Floats]]:
    """Yield what is open between a group and the others: constants, and what turns with it."""
    for name in COMPONENTS:
        yield {name: own}
    cos, sin = own * np.cos(angles), own * np.sin(angles)
    for x, y in PAIRS:
        yield {x: cos, y: sin}
        yield {x: -sin, y: cos}


def _free_directions(solution: PlateSolution) -> tuple[FreeDirection, ...]:
    """Return the offsets of all groups but the first against it, and what turns with each."""
    angles, name = solution.problem.angles[solution.table_positions], _groups_in_words(solution)
    every = (each for own in solution.members[1:] for each in _directions(own, angles))
    return tuple(FreeDirection(name, columns) for columns in every)


def _groups_in_words(solution: PlateSolution) -> Phrase:
    count = solution.layout.groups
    names = phrase("{0} groups of", count) if count > 2 else phrase("odd and even")
    return phrase("the {0} table positions", names)


def _doubts(solution: PlateSolution) -> Iterator[Phrase]:
    found = solution.found
    for effect in found.found_effects:
        if effect.effect.effect == "growth":
            yield _of_growth(effect, solution.fitted.material)
    estimated = found.diagnosis.noise.estimated
    if not found.model.unstated or estimated is None:
        return
    noise, known = found.fit.std[:3], estimated.log_std[found.model.of_component[:3]]
    apart = np.hypot(known[noise.argmin()], known[noise.argmax()])
    least = np.log(noise.max() / noise.min()) - normal_isf(0.5 * AXIS_SIGNIFICANCE) * apart
    odd = solution.alike is not None and solution.alike < AXIS_SIGNIFICANCE
    if odd or least > np.log(UNEQUAL):
        shown = ", ".join(f"{size / MICROMETRE:.3g}" for size in noise.tolist())
        yield phrase(SCATTER_UNEQUALLY, shown)


def _of_growth(found: FoundEffect, material: str) -> Phrase:
    amount = float(found.sizes[0])
    warmed, warms = kelvin(amount, material), phrase("warms") if amount > 0.0 else phrase("cools")
    if warmed is None:
        cause = phrase("plan.plate.material would give it in kelvin")
    elif abs(warmed) > PLAUSIBLE_K:
        cause = phrase(
            "{0} does not with {1:g} K: the machine's scales changed", material, PLAUSIBLE_K
        )
    else:
        cause = phrase("as {0} does that {1} by {2:.2g} K", material, warms, abs(warmed))
    return phrase(
        PLATE_GREW, phrase("grew") if amount > 0.0 else phrase("shrank"),
        abs(amount) / MICROMETRE, cause
    )  # fmt: skip


def _warnings(solution: PlateSolution) -> Iterator[Phrase]:
    problem = solution.fitted
    left_out = np.setdiff1d(np.arange(problem.n_positions), solution.table_positions)
    if len(left_out):
        yield phrase(
            FEW_BALLS_LEFT, len(left_out), problem.n_positions, MIN_BALLS,
            ", ".join(map(str, left_out))
        )  # fmt: skip
    if solution.layout.groups > 1:
        yield phrase(OWN_ZEROS, _groups_in_words(solution))
    elif problem.complete:
        yield from separability(problem.grid, problem.balls).sentences()
    if solution.problem.closed_form and not solution.closes:
        yield phrase(NOT_CLOSED_FORM)
    if problem.drift:
        drift = _drift(solution)
        size, band = drift["amount"][0] / MICROMETRE, 2.0 * drift["std"][0] / MICROMETRE
        shown = ", ".join(f"{a:.3f} +- {u:.3f}" for a, u in zip(size, band, strict=True))
        yield phrase(ORIGIN_DRIFTS, shown)


def _drift(solution: PlateSolution) -> dict[str, Floats]:
    """Return the drift (q, 3) of the origin over the run by order, along x, y, z, m; its std."""
    fit, first = solution.found.fit, solution.layout.unknowns
    own = slice(first, first + 3 * solution.fitted.drift)
    std = np.linalg.norm(fit.gain(own), axis=1)
    return {"amount": fit.x[own].reshape(-1, 3), "std": std.reshape(-1, 3)}


def _details(solution: PlateSolution) -> dict[str, Any]:
    """Everything else the method knows, in SI; one entry per group under ``groups``."""
    layout, found, problem = solution.layout, solution.found, solution.fitted
    kernel, each = found.fit.kernel, dict[str, tuple[Floats, Floats]]()
    for name, rows in layout.others.items():
        std = found.scale * np.sqrt(kernel.variances_of(rows))
        each[name] = rows.times(found.fit.x).reshape(-1, 3), std.reshape(-1, 3)
    table, cmm, ball = layout.group
    of_group = {"plate_errors": ball, "cmm_errors": cmm}
    back = np.swapaxes(solution.rows.frame, 1, 2)
    left = (back @ found.fit.residual.reshape(-1, 3, 1))[:, :, 0]
    noise = found.fit.std[: 3 * len(layout.row)].reshape(-1, 3)
    return {
        "grid": problem.grid,
        "radius": problem.radius,
        "sigma_axes": np.sqrt((noise**2).mean(axis=0)),
        **({"origin_drift": _drift(solution)} if problem.drift else {}),
        "groups": [
            {
                "table_positions": np.sort(layout.table_positions[table == group]),
                "ball_steps": layout.ball_steps[ball == group],
                "cmm_positions": layout.cmm_steps[cmm == group],
            }
            | {
                f"{name}{of}": value[group if name.startswith("axis") else of_group[name] == group]
                for name, pair in each.items()
                for of, value in zip(("", "_std"), pair, strict=True)
            }
            for group in range(layout.groups)
        ],
        "residual_rows": {
            "row": problem.rows[layout.row],
            "cmm_index": problem.cmm_index[layout.row],
            "vector": left,
        },
    }


ALWAYS: Final = (
    Protection(
        "axis noise",
        "estimated",
        phrase(
            "in the plane and along the axis each, where nothing is stated or the statement fails"
        ),
    ),
    Protection("error motion", "estimated", phrase("all six deviations are results")),
    Protection("refraction", "harmless", phrase("no light is used")),
    Protection(
        "tilt", "estimated", phrase("the pose of the axis and the place of each ball are unknowns")
    ),
    Protection(
        "numbering",
        "not protected",
        phrase(
            "which table angle belongs to position 0 is taken from the table: positions that "
            "are all numbered off by one fit as well, on a plate whose ball steps are off by "
            "as many the other way"
        ),
    ),
    Protection(
        "sign of z",
        "not protected",
        phrase(
            "that z points away from the table is taken from the frame: a z column of the "
            "other sign fits every centre as well and turns the signs of EZC, EAC and EBC; "
            "touch points on the upper half of the balls would show which"
        ),
    ),
)
"""What is said of every measurement."""


def _protections(solution: PlateSolution) -> Iterator[Protection]:
    problem, found, count = solution.problem, solution.found, solution.layout.groups
    yield from ALWAYS
    drift = problem.drift_allowance / MICROMETRE
    if problem.drift:
        shape = phrase(("linear", "quadratic")[problem.drift - 1])
        yield Protection(
            "drift", "estimated", phrase("a {0} drift of each axis is an unknown", shape)
        )
    elif drift and any(
        p.effect == "drift" and (p.error is None or p.error > TOLERABLE)
        for p in found.protections()
    ):
        yield Protection(
            "drift", "bounded", phrase("the budget holds {0:g} um over the run", drift)
        )
    turned = np.concatenate([np.arange(part.start, part.stop) for name, part in
                             solution.parts.items() if name in ROTATIONS])  # fmt: skip
    share = np.abs(found.value[turned]) / np.maximum(found.std[turned], 1e-300)
    yield Protection(
        "scale",
        "tested",
        phrase("a wrong radius of the ball circle shows in all centres; it scales the rotations"),
        RADIUS_TOLERANCE * float(share.max()),
    )
    if count > 1 and problem.group_allowance:
        size = problem.group_allowance / MICROMETRE
        yield Protection(
            "gauge", "bounded", phrase("the budget holds {0:g} um between the groups", size)
        )
    elif count > 1:
        why = phrase("{0} groups of table positions have each a zero of their own", count)
        yield Protection("gauge", "not protected", why)
    else:
        yield Protection(
            "gauge",
            "harmless",
            phrase(
                "mean values, and what a shifted or tilted plate causes, are not part of "
                "the curves"
            ),
        )
    if len(solution.fitted.rows) < 1.4 * (int(solution.fitted.stop.max()) + 1):
        why = phrase("every centre has a stop of its own, so it is part of the residuals")
        yield Protection("repeatability", "estimated", why)
    else:
        why = phrase(
            "not included: each position was reached once, or too few times to estimate it"
        )
        yield Protection("repeatability", "not protected", why)
