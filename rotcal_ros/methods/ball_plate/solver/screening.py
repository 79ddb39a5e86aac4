"""Gross mistakes of set-up and table, found before any fit: refused or flagged with the reason.

Every centre must lie near the place that its ball and its table position give it, once the plate's
place on the table and the axis's place in the frame are allowed for: the fit takes them exactly.
Where most do not, the pattern shows the mistake; where a few do not, those rows are set aside.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Complexes, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

TWICE: Final = noted(
    "measured {0} times while ball {1} is missing there; which is which is not known"
)
OFF_THE_CIRCLE: Final = noted("the centre lies {0:.3f} mm off the circle")
OFF_ITS_PLACE: Final = noted("the centre lies {0:.2f} degrees from its place")
AT_STEP: Final = noted(
    "the centre lies {0:.2f} degrees from its place, where ball step {1} stands"
)

RADIUS_TOLERANCE = 0.002
"""Largest accepted relative difference between measured and stated ball circle."""
CENTRE_TOLERANCE = 0.03
"""Largest accepted distance of axis and origin, and of plate and axis, as part of the radius."""
PLACE_TOLERANCE = 0.25
"""Largest accepted angle between a centre and its place, in grid steps."""
HEIGHT_TOLERANCE = 0.05
"""Largest accepted distance of a centre from the middle height, as part of the radius."""
FITS = 0.01
"""Largest typical distance of a centre from its place for the shifts to be believed."""
ROUNDS = 10
"""Rounds of the robust fit of the two shifts."""
COHERENT = 0.9
"""Length of the mean direction of a ball's centres, 1 at most, from which on they are at rest."""
FEW = 0.2
"""Part of the rows that may be misplaced before the whole table is refused."""


def screen(problem: BallPlateProblem) -> tuple[BallPlateProblem, list[Rejection]]:
    """Return the rows worth fitting, and the others with the reason why not.

    Raises DataError when the whole table is not what it says: lengths in millimetres, a circle of
    another radius or not around the axis, balls numbered the other way round, a plate mounted
    shifted or upside down, a table that turns clockwise, one ball measured in place of another.
    Flagged: centres that are not finite, single centres far from their place, doubled centres
    while others are missing.
    """
    finite: Bools = np.all(np.isfinite(problem.centres), axis=1)
    rejected = [
        Rejection(
            int(problem.rows[r]), phrase("{0}: the centre is not finite", problem.row_name(r))
        )
        for r in np.flatnonzero(~finite)
    ]
    if not finite.any():
        raise DataError("no centre is finite: check the columns x_m, y_m, z_m of the table")
    problem = problem.take(finite)
    there = _centred(problem)
    _check_circle(there)
    for step in (_displaced, _off_height, _doubled):
        bad, reasons = step(there)
        rejected += [
            Rejection(int(problem.rows[r]), phrase("{0}: {1}", problem.row_name(r), why))
            for r, why in zip(bad, reasons, strict=True)
        ]
        if len(bad):
            good = np.setdiff1d(np.arange(len(problem.centres)), bad)
            problem, there = problem.take(good), there.take(good)
    return problem, rejected


def _centred(problem: BallPlateProblem) -> BallPlateProblem:
    """Take the shifts of axis and plate off the centres, where they explain them.

    x + i y is the sum of a constant, the axis; a part that turns with the table, the plate; and
    the nominal place times a factor. The fit is robust (least absolute distances, by weights), so
    that a ball in another's place does not pull. Raises DataError for a shift that is too large.
    """
    plane = problem.centres[:, 0] + 1j * problem.centres[:, 1]
    turn = np.exp(1j * problem.angles)
    design = np.column_stack(
        [np.ones_like(plane), turn[problem.position], problem.radius * turn[problem.cmm_index]]
    )
    weight, distance = np.ones(len(plane)), np.zeros(len(plane))
    found = np.zeros(3, dtype=np.complex128)
    for _ in range(ROUNDS):  # weights 1/distance make least squares least absolute distances
        weighted = (weight[:, None] * design).conj().T
        found = np.linalg.lstsq(weighted @ design, weighted @ plane, rcond=1e-12)[0]
        distance = np.abs(plane - design @ found)
        weight = 1.0 / np.maximum(distance, 1e-6 * problem.radius)
    if np.median(distance) > FITS * problem.radius:
        return problem  # another mistake, named by the steps that follow
    for shift, what in (
        (found[0], "the table's axis lies {} mm off the origin: put the origin of the CMM's frame "
         "on the table's axis"),
        (found[1], "the plate lies {} mm off the table's axis: centre it"),
    ):  # fmt: skip
        if abs(shift) > CENTRE_TOLERANCE * problem.radius:
            place = f"({shift.real / MILLIMETRE:.3f}, {shift.imag / MILLIMETRE:.3f})"
            raise DataError(what.format(place))
    off = design[:, :2] @ found[:2]
    return replace(
        problem, centres=problem.centres - np.column_stack([off.real, off.imag, 0 * off.real])
    )


def _check_circle(problem: BallPlateProblem) -> None:
    plane = problem.centres[:, :2]
    distance = np.hypot(plane[:, 0], plane[:, 1])
    typical = float(np.median(distance))
    stated = problem.radius
    if typical > 100.0 * stated:
        raise DataError(
            f"the centres lie {typical:.6g} from the axis, the plate's circle has a radius of "
            f"{stated:.6g} m: the table looks like millimetres, metres are expected"
        )
    near = np.abs(distance - typical) < 0.2 * typical
    # |p|^2 = 2 p c + r^2 - |c|^2 is linear in the centre c and in a constant (Kasa's circle)
    design = np.column_stack([2.0 * plane[near], np.ones(near.sum())])
    x, y, constant = np.linalg.lstsq(design, distance[near] ** 2, rcond=None)[0]
    radius = float(np.sqrt(max(constant + x**2 + y**2, 0.0)))
    if abs(radius - stated) > RADIUS_TOLERANCE * stated:
        raise DataError(
            f"the centres lie on a circle of radius {radius:.6f} m, the plate says "
            f"{stated:.6f} m: wrong plate file, or probe points of the wrong ball diameter; "
            "correct it"
        )
    if np.hypot(x, y) > CENTRE_TOLERANCE * stated:
        raise DataError(
            f"the circle of the centres is ({x / MILLIMETRE:.3f}, {y / MILLIMETRE:.3f}) mm off "
            "the origin: put the origin of the CMM's frame on the table's axis"
        )


def _displaced(problem: BallPlateProblem) -> tuple[Ints, list[Phrase]]:
    """Return rows whose centre is not where ball and table position put it."""
    angle = np.arctan2(problem.centres[:, 1], problem.centres[:, 0])
    step = 2.0 * np.pi / problem.grid
    on_plate = angle - problem.angles[problem.position]
    off = wrap_angle(on_plate - problem.angles[problem.ball_step]) / step
    bad = np.flatnonzero(np.abs(off) > PLACE_TOLERANCE)
    if len(bad) > FEW * len(off):
        raise DataError(_mistake(problem, angle))
    _check_whole_balls(problem, bad, on_plate / step)
    found = np.round(on_plate[bad] / step).astype(int) % problem.grid
    reasons = [
        phrase(
            AT_STEP if place in problem.balls else OFF_ITS_PLACE,
            abs(off[r]) * step / DEGREE,
            place,
        )
        for r, place in zip(bad, found, strict=True)
    ]
    return bad, reasons


def _check_whole_balls(problem: BallPlateProblem, bad: Ints, steps: Floats) -> None:
    """Refuse when all centres of a ball lie where another ball stands."""
    for ball in problem.balls:
        rows = np.flatnonzero(problem.ball_step == ball)
        if not np.isin(rows, bad).all():
            continue
        places = np.round(steps[rows]).astype(int) % problem.grid
        place = int(np.bincount(places).argmax())
        if place in problem.balls:
            raise DataError(
                f"all centres called ball step {ball} lie where ball step {place} stands: ball "
                f"{place} was measured twice and ball {ball} not at all; probe ball {ball}"
            )
        raise DataError(
            f"all centres called ball step {ball} lie at step {place}, where the plate has no "
            "ball: correct the ball steps of the plate file"
        )


def _mistake(problem: BallPlateProblem, angle: Floats) -> str:
    grid, table = problem.grid, problem.angles[problem.position]
    if _coherence(problem, angle - table) < COHERENT:
        return _turning_otherwise(problem, angle + table)
    found = np.angle(_of_balls(problem, angle - table))
    found_steps = np.round(found * grid / (2.0 * np.pi)).astype(int) % grid
    shifts = np.unique((found_steps - problem.balls) % grid)
    if len(shifts) > 1:
        return _reversed(problem, found_steps)
    if shifts[0] == 0:
        return _between_steps(problem, found)
    shift = int(shifts[0] if shifts[0] <= grid // 2 else shifts[0] - grid)
    return (
        f"all centres lie {shift} grid steps ({shift * 360.0 / grid:g} degrees) from their "
        "place: the plate is mounted shifted; turn it back, or number the ball steps "
        "from the ball that stands on +x. Or the table positions are numbered off by as many: "
        "with the balls renumbered to fit, each deviation would stand at another angle"
    )


def _turning_otherwise(problem: BallPlateProblem, mirrored: Floats) -> str:
    """Say how the balls turn that do not turn with the table.

    ``mirrored`` (n,): where they stand on a plate that turns the other way round, rad.
    """
    if _coherence(problem, mirrored) <= COHERENT:
        return (
            "the centres of a ball do not turn with the table: the columns position and "
            "ball_step, or the grid of the plate, do not belong to these centres"
        )
    seen, places = np.angle(_of_balls(problem, mirrored)), problem.angles[problem.balls]
    reverse, straight = (abs(np.exp(1j * (seen + sign * places)).mean()) for sign in (1.0, -1.0))
    if reverse > 0.99 > straight:
        return (
            "in these coordinates both the balls' steps and the table run clockwise: the "
            "frame of the CMM is left-handed or its z axis points down (an axis turned "
            "round, or two exchanged); make it right-handed, with z along the table's "
            "axis and away from the table"
        )
    return (
        "the balls move clockwise while the table positions count up: table angles must "
        "be counter-clockwise seen from +z; reverse the sign of the table angle"
    )


def _reversed(problem: BallPlateProblem, found: Ints) -> str:
    grid, balls = problem.grid, problem.balls
    mirrored = len(np.unique((found + balls) % grid)) == 1
    renumbered = any(
        np.array_equal(np.roll(found[::-1], turn), balls) for turn in range(len(balls))
    )
    if mirrored and renumbered:
        return (
            "the balls run clockwise: the plate is numbered the other way round or mounted "
            "upside down; number counter-clockwise seen from +z"
        )
    if mirrored:
        return (
            "the balls stand at the mirrored steps: the plate is mounted upside down, or its "
            "steps were counted clockwise; turn the plate over"
        )
    if renumbered:
        return (
            "the balls stand where the plate has balls, but in reverse order: they are numbered "
            "the other way round; number counter-clockwise seen from +z"
        )
    pairs = ", ".join(f"{b} at {f}" for b, f in zip(balls, found, strict=True) if b != f)
    return f"balls do not stand at their steps (ball step at step: {pairs}): wrong plate file"


def _between_steps(problem: BallPlateProblem, found: Floats) -> str:
    """Say how far the balls stand from their places, none of them nearer to another step."""
    off = wrap_angle(found - problem.angles[problem.balls]) / DEGREE
    if np.ptp(off) < PLACE_TOLERANCE * 360.0 / problem.grid:
        return (
            f"all centres lie {off.mean():.2f} degrees from their place, less than a grid step: "
            "the plate is mounted turned; turn it back"
        )
    named = ", ".join(f"{b} by {o:.2f} degrees" for b, o in zip(problem.balls, off, strict=True))
    return f"balls lie away from their steps (ball step {named}): wrong plate file"


def _off_height(problem: BallPlateProblem) -> tuple[Ints, list[Phrase]]:
    """Return rows whose centre is far above or below the others, or off the circle."""
    height = problem.centres[:, 2] - np.median(problem.centres[:, 2])
    distance = np.hypot(problem.centres[:, 0], problem.centres[:, 1]) - problem.radius
    worst = np.where(np.abs(height) > np.abs(distance), height, distance)
    bad = np.flatnonzero(np.abs(worst) > HEIGHT_TOLERANCE * problem.radius)
    reasons = [phrase(OFF_THE_CIRCLE, worst[r] / MILLIMETRE) for r in bad]
    return bad, reasons


def _doubled(problem: BallPlateProblem) -> tuple[Ints, list[Phrase]]:
    """Return rows of a ball measured twice at a table position where another is missing."""
    _, cell, count = np.unique(problem.cell, return_inverse=True, return_counts=True)
    times = count[cell]
    bad: list[int] = []
    reasons = []
    for r in np.flatnonzero(times > 1).tolist():
        there = problem.ball_step[problem.position == problem.position[r]]
        missing = np.setdiff1d(problem.balls, there)
        if len(missing):
            bad.append(r)
            reasons.append(phrase(TWICE, times[r], ", ".join(map(str, missing))))
    return np.array(bad, dtype=np.int64), reasons


def _of_balls(problem: BallPlateProblem, angle: Floats) -> Complexes:
    """Return the mean of exp(i ``angle``) (R,) of each ball; ``angle`` (n,), rad."""
    phase = np.exp(1j * angle)
    return np.array([np.mean(phase[problem.ball_step == ball]) for ball in problem.balls])


def _coherence(problem: BallPlateProblem, angle: Floats) -> float:
    """Return how constant the angle is for each ball, 1 = perfectly, median over the balls."""
    return float(np.median(np.abs(_of_balls(problem, angle))))
