"""What two circles beside each other read, for the engine.

    reading = t(theta) - r(theta - shift) + zero of the setting + noise

All angles are radians, counter-clockwise about the table axis positive: ``t`` is the table's
deviation (actual - commanded) at its angle ``theta``, ``r`` the error of the reference
(actual - nominal) at the angle that it shows then, ``shift`` the table angle at which it shows its
zero. A reading is positive where the table has turned farther than the reference says.

With several shifts both circles are unknown and both are found, a rosette of two. Order n of a
complete circle with K shifts s has the normal matrix

    [[K, -S], [-conj(S), K]],    S = sum over k of exp(i n s_k),

so that its variance is K / (K^2 - |S|^2) times that of a reading; where |S| = K nothing separates
the order of the table from that of the reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import csr_array

from rotcal_ros.adjust.circles import CircularDesign
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Disturbing, Grouping, Model, instrument_effects, linear
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_ros.methods.angle_comparison.settings import (
    SIGNS,
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

INSTRUMENT, MOVED = "the instrument", "reference or instrument"
"""What effects are called after."""
LEANING: Final = "the reference leans"
WORDS: Final = Words(
    "readings", "a draught, heat or a person", "at the reference", "at the reference"
)
NEAR_RAD: Final = 0.01 * DEGREE
"""Difference by which angles of marks may be rounded where they are written."""
SAME_DIGITS: Final = 9
"""Digits of a turn to which angles are compared: 1.3 milliarcsec."""
LOST: Final = 1e-9
"""Share of K^2 that K^2 - |S|^2 may be, by rounding, where an order is lost."""
REFERENCE: Final = "reference error"
"""What is determined beside the table's deviations: from their mean, where they are unknown."""


@dataclass(frozen=True, eq=False)
class Circles:
    """Which marks of the two circles meet.

    ``angles`` (p,), rad, and ``approaches`` (p,) of the table positions; ``table`` (p,): number of
    the table's unknown, the same at the same angle from the same side. ``marks`` (m,), rad: the
    angles that the reference shows, ascending in one turn; ``shown`` (k, p): the number of the
    mark at each setting and position.
    """

    angles: tuple[float, ...]
    approaches: tuple[Approach, ...]
    table: Ints
    marks: Floats
    shown: Ints

    @classmethod
    def of(cls, plan: ComparisonPlanSettings) -> Circles:
        """Return those of the settings of a plan; raises PlanError as :func:`table_angles`."""
        up = table_angles(plan)
        angles = up + up[::-1] * plan.bidirectional
        down = len(angles) - len(up)
        approaches = (Approach.POSITIVE,) * len(up) + (Approach.NEGATIVE,) * down
        shifts = np.array(plan.shifts_deg) * DEGREE
        marks, shown = _marks(np.array(angles) - shifts[:, None])
        _, table = _marks(np.array(angles))
        table[len(up) :] += len(up)
        _, table = np.unique(table, return_inverse=True)
        return cls(angles, approaches, table, marks, shown)

    @property
    def n_table(self) -> int:
        """How many deviations of the table are unknown."""
        return int(self.table.max()) + 1


def _marks(angles: Floats) -> tuple[Floats, Ints]:
    """Return the different angles (m,) in one turn, and which of them each of ``angles`` is.

    Faces of a polygon at 51.4286 degrees, as people write them, do not add up to a turn: what is
    nearer than NEAR_RAD, and than a hundredth of the smallest step in a setting, is one mark.
    """
    share = np.round(angles / TURN % 1.0, SAME_DIGITS) % 1.0
    each, number = np.unique(share, return_inverse=True)
    steps = np.diff(np.unique(share.reshape(-1, share.shape[-1])[:1]))
    near = min(NEAR_RAD / TURN, 0.01 * steps.min(initial=1.0))
    begins = np.diff(each, prepend=-1.0) > near
    marks, mark = each[begins] * TURN, np.cumsum(begins) - 1
    if len(marks) > 1 and each[0] + 1.0 - each[-1] <= near:  # just below a whole turn
        marks, mark = marks[:-1], mark % (len(marks) - 1)
    return marks, mark[number].reshape(angles.shape)


def lost_orders(circles: Circles, shifts: Floats) -> tuple[int, ...]:
    """Return the orders that ``shifts`` (k,), rad, lose, where both circles have the same grid.

    Where they have not, none are named here: the engine names the unknowns.
    """
    n = len(circles.marks)
    uneven = np.ptp(np.diff(circles.marks, append=circles.marks[0] + TURN))
    even = uneven < 10.0 ** (1 - SAME_DIGITS) * TURN
    if len(np.unique(_marks(np.array(circles.angles))[1])) != n or not even:
        return ()
    orders = np.arange(1, n // 2 + 1)
    squares = np.abs(np.exp(1j * np.multiply.outer(orders, shifts)).sum(axis=1)) ** 2
    lost = len(shifts) ** 2 - squares < LOST * len(shifts) ** 2
    return tuple(orders[lost].tolist())


def readings_of(plan: ComparisonPlanSettings) -> Readings:
    """Return readings of a whole plan that are all 0, in its order: what a prediction needs."""
    shown = Circles.of(plan).shown
    station, position = np.indices(shown.shape).reshape(2, -1)
    return Readings(position, shown.ravel(), station, np.zeros(shown.size), np.arange(shown.size))


def known_reference(solver: ComparisonSolverSettings, circles: Circles) -> bool:
    """Whether the reference has a certificate; else its errors are unknown, or taken for none."""
    return len(solver.reference_errors_arcsec) == len(circles.marks)


def model_of(
    plan: ComparisonPlanSettings, solver: ComparisonSolverSettings, read: Readings
) -> Model:
    """Return unknowns, readings and what could spoil them; outputs are those of the positions.

    With one shift and no certificate the reference is taken for perfect. A certificate counts from
    a zero of its own, as a setting does.
    """
    circles, settings = Circles.of(plan), len(plan.shifts_deg)
    largest = solver.largest_shift_arcsec * ARCSEC
    certified = known_reference(solver, circles)
    blocks = {
        "table angle": circles.n_table,
        "reference mark": len(circles.marks) if certified or settings > 1 else 0,
        "setting": settings + certified,
    }
    table, mark, _ = blocks.values()
    design = _design(circles, read, mark, sum(blocks.values()))
    unknowns = np.arange(sum(blocks.values()))
    first = np.where(unknowns == circles.table[0], -1.0, 0.0)
    of_mark = (unknowns >= table) & (unknowns < table + mark)
    mean = np.where(of_mark, -1.0 / max(mark, 1), 0.0)
    marks = Outputs.picked(unknowns[table : table + mark], mean)
    model = Model(
        blocks=blocks,
        observed=SIGNS[solver.readings_count] * read.value,
        std=np.full(len(read.value), solver.sigma_arcsec * ARCSEC),
        equations=linear(design),
        outputs=Outputs.picked(circles.table, first),
        further={REFERENCE: marks} if mark else {},
        words=WORDS,
        components=("the readings",),
        groupings=(
            Grouping("setting", read.station, along=read.when),
            Grouping("reference mark", read.target),
            Grouping("position", read.position),
        ),
        effects=(
            *instrument_effects(INSTRUMENT, read.station, read.when, largest, moved=MOVED),
            Disturbing("polygon tilt", LEANING, _leaning(circles, read, settings), largest),
        ),
    )
    if not certified:
        return model
    errors = np.array(solver.reference_errors_arcsec) * ARCSEC
    known = np.eye(mark, sum(blocks.values()), table)
    known[:, -1] = 1.0
    return model.with_prior("the certificate", known, errors, solver.reference_std_arcsec * ARCSEC)


def _leaning(circles: Circles, read: Readings, settings: int) -> Floats:
    """Return what is read more where the reference leans, another way in each setting: (n, 4 k).

    An axis that leans by a turns faces by a^2 / 4 twice in a turn, and once by a times the angle
    by which the instrument itself is turned about its line of sight.
    """
    angle = np.array(circles.angles)[read.position]
    waves = np.stack([f(order * angle) for order in (1, 2) for f in (np.cos, np.sin)], axis=1)
    each = read.station[:, None] == np.arange(settings)
    return np.asarray((each[:, :, None] * waves[:, None]).reshape(len(angle), -1))


def _design(
    circles: Circles, read: Readings, mark: int, unknowns: int
) -> CircularDesign | csr_array:
    """Return the design of readings, of ``mark`` errors of the reference and all ``unknowns``.

    Where the reference has the same places as the table it is solved order by order.
    """
    table = circles.n_table
    column = np.stack(
        [circles.table[read.position], table + read.target, table + mark + read.station], axis=1
    )
    value = np.array([1.0, -1.0, 1.0])
    if not mark:
        column, value = column[:, ::2], value[::2]
    entries = np.tile(value, len(column)), column.ravel(), len(value) * np.arange(len(column) + 1)
    rows = csr_array(entries, shape=(len(column), unknowns))
    if not mark or table % mark:
        return rows
    return CircularDesign.of(rows, table // mark + 1, mark)
