"""The zeros that lengths count from: shifts, jumps, slips that stay unseen, and zeros that wander.

All lengths of a *segment*, one unbroken beam, count from one zero. What can happen to it:

shift
    From some moment on all lengths of the segment are longer by the same amount. To first order
    about an adjustment: how strongly the lengths speak for it, how well they determine its size,
    and by how much it moves the stations unseen.
jump
    A shift that was not reported: a slipped fringe, or a beam that broke unseen. It is tested like
    an outlier: the score of the shift over its standard deviation, with the unexplained scatter of
    the other residuals (externally studentised). It has to stand out more than any single length,
    which would be an outlier itself. The zero is then split there, which costs one unknown. The
    size is left free. That a slip is a whole fringe helps little to find it: the best of all tests
    for slips of one fringe at any moment (Neyman and Pearson: the mean of the likelihood ratios)
    finds hardly more of them (``scripts/zero_coverage.py --best``).
slip
    A fringe that the counter lost without being found: the uncertainty allows for it. A
    measurement with one slip is taken to be as likely as one with none (SLIPPED), and any moment
    of it as any other. The probability with which the test for jumps misses a slip follows from
    the geometry, and so does what the slip then does to the stations, or to the curves of a whole
    table; the covariance is the expected square of that. Like any covariance it does not depend on
    the readings, and can be stated in advance. Of a whole table, where slips do more and are found
    less, the readings are asked: each moment has the probability that its likelihood ratio leaves.
walk
    Dead path and temperature move a zero a little all the time. Every length then gets a zero of
    its own, and the steps from one to the next, in the order of measuring, are observations: zero,
    with the standard deviation of the walk. That is exact; the steps make a band in the normal
    matrix of the zeros. An unknown standard deviation is estimated by restricted maximum
    likelihood from the same normal matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.effects import limit_of_family
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.protection import POWER, TOLERABLE, Protection
from rotcal_ros.methods.tracer.solver.problem import Grid
from rotcal_ros.methods.tracer_six.lengths.adjustment import Adjustment

LEAST_SIDE: Final = 4
"""Lengths on either side of a shift that is searched for: fewer are outliers."""
CANDIDATES: Final = 256
"""Moments that stand for all of them."""
PLACES: Final = 2_000_000
"""Places of the grid, of all moments of a chunk together."""
MOST_FRINGES: Final = 3
"""Fringes that a counter slips at once; what is more is a beam that was broken."""
AGREES: Final = 2.58
"""Standard deviations by which the size of a slip may miss a whole number of fringes; 99 %."""
MOST_JUMPS: Final = 10
"""Jumps after which no further ones are searched for: such a beam is not unbroken at all."""
SLIPPED: Final = 0.5
"""Probability that a measurement holds a slip."""


@dataclass(frozen=True, eq=False)
class TimedLengths:
    """Lengths in use in the order of time: strip and target (k,), and segment number (k,).

    ``side`` (k,): how many lengths of its segment each has before it, or from it on, if fewer.
    ``own`` (p, n): segment number of each place of the grid, strips alike or (p, 1).
    """

    strip: Ints
    target: Ints
    segment: Ints
    side: Ints
    own: Ints

    @classmethod
    def of(cls, grid: Grid, order: Ints, own: Ints | None = None) -> TimedLengths:
        """Return those of ``grid``; ``order`` (k,): when each row of the problem was taken.

        ``own``: segment of each place of the grid; None: as the grid has it.
        """
        own = grid.segment_of_strip[:, None] if own is None else own
        strip, target = np.nonzero(grid.used)
        rank = np.argsort(order[grid.row[strip, target]], kind="stable")
        strip, target = strip[rank], target[rank]
        segment = np.broadcast_to(own, grid.used.shape)[strip, target]
        before = np.zeros(len(segment), dtype=np.int64)
        total = np.bincount(segment)
        for number, count in enumerate(total.tolist()):
            before[segment == number] = np.arange(count)
        return cls(strip, target, segment, np.minimum(before, total[segment] - before), own)

    def few(self) -> Ints:
        """Return up to CANDIDATES moments, evenly among those that a shift can begin at."""
        possible = np.flatnonzero(self.side > 0)
        return np.asarray(possible[:: max(1, -(-len(possible) // CANDIDATES))])

    def later(self, grid: Grid, moments: Ints) -> Bools:
        """Return (t, p, n) the places of each moment's segment that come with or after it."""
        time = np.full(grid.used.shape, -1)
        time[self.strip, self.target] = np.arange(len(self.strip))
        own = self.own == self.segment[moments][:, None, None]
        return np.asarray((time >= moments[:, None, None]) & own, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class Shifts:
    """Shifts that begin at the moments ``at`` (t,), of all ``moments`` there are.

    ``score`` (t,): slope of half of chi-squared, 1/m; ``information`` (t,): of the size, 1/m^2.
    ``alike`` (t,): correlation with the score before, 1 for the first. ``moved`` (t, q): what a
    shift of a metre does to what is adjusted without it, the stations (3 m,) or curves (6 m,).
    """

    moments: TimedLengths
    at: Ints
    score: Floats
    information: Floats
    alike: Floats
    moved: Floats

    @property
    def enough(self) -> Bools:
        """Whether a shift (t,) has lengths enough on either side to be searched for."""
        return np.asarray(self.moments.side[self.at] >= LEAST_SIDE)

    @property
    def squared(self) -> Floats:
        """What chi-squared (t,) falls by when the size is free."""
        return np.asarray(self.score**2 / self.information)

    def about(self, k: int) -> Ints:
        """Return all moments about the one that shift ``k`` begins at, with lengths enough."""
        enough = np.flatnonzero(self.moments.side >= LEAST_SIDE)
        reach = len(enough) // len(self.at) + 1
        return np.asarray(enough[np.abs(enough - self.at[k]) <= reach])

    def limit(self, significance: float) -> float:
        """Return what the largest normalised score exceeds by chance; ``significance`` two-sided.

        See :func:`rotcal_ros.adjust.effects.limit_of_family`.
        """
        return limit_of_family(significance, self.alike[self.enough][1:])


class ShiftResponse(NamedTuple):
    """What shifts of one metre (t) do in a network.

    ``total`` (t,): their chi-squared if nothing followed them, ``taken`` (t,): the part that the
    unknowns take up, 1/m^2. ``both`` (t - 1,): what is left of each and the one before together.
    ``moved`` (t, q): as in :class:`Shifts`.
    """

    total: Floats
    taken: Floats
    both: Floats
    moved: Floats


@dataclass(frozen=True, slots=True)
class Jump:
    """From the problem's row ``row`` on, the lengths of ``segment`` are ``size`` (m) longer.

    ``std``: standard deviation of the size, m; ``value``: that many of them, studentised.
    """

    segment: int
    row: int
    size: float
    std: float
    value: float

    def fringes(self, fringe: float) -> int:
        """Return how many times ``fringe`` (m) it is; 0 if it is no whole number, or many."""
        number = round(self.size / fringe) if fringe else 0
        agrees = abs(self.size - number * fringe) <= AGREES * self.std
        return number if agrees and abs(number) <= MOST_FRINGES else 0


@dataclass(frozen=True, eq=False)
class ShiftSearch:
    """Shifts of the zeros of ``grid`` about its adjustment ``fit``, at any of the ``moments``.

    ``respond`` says what their network makes of shifts, from the lengths (t, p, n) that each makes
    longer; ``width``: q. ``overlap``: moments that a chunk has in common with the next, whose
    correlation is then given too.
    """

    grid: Grid
    fit: Adjustment
    moments: TimedLengths
    respond: Callable[[Bools], ShiftResponse]
    width: int
    overlap: int = 0

    def few(self) -> Shifts:
        """Return shifts at up to CANDIDATES moments, evenly among those that one can begin at."""
        return self.at(self.moments.few())

    def at(self, begins: Ints) -> Shifts:
        """Return the shifts that begin at some of the moments (t,), chunk by chunk."""
        grid, count = self.grid, len(begins)
        score, information, alike = np.zeros(count), np.zeros(count), np.ones(count)
        moved = np.zeros((count, self.width))
        size = max(1 + self.overlap, PLACES // grid.used.size)
        for begin in range(0, count, size - self.overlap):
            part = slice(begin, begin + size)
            later = self.moments.later(grid, begins[part])
            felt = self.respond(later)
            score[part] = (later * (grid.weights * self.fit.residual)).sum(axis=(1, 2))
            # what the unknowns take up entirely leaves rounding, which is no information
            left = np.maximum(felt.total - felt.taken, 1e-9 * felt.total)
            information[part], root = left, np.sqrt(left)
            alike[part][1:] = felt.both / (root[1:] * root[:-1])
            moved[part] = felt.moved
        return Shifts(self.moments, begins, score, information, alike, moved)

    def jump(self, shifts: Shifts, significance: float, margin: float = 1.0) -> Jump | None:
        """Return the jump that stands out most among and about ``shifts``; None if none does.

        ``significance``: of the largest of all moments, two-sided; the limit is ``margin`` times
        its quantile. The jump's segment is a number of the moments'.
        """
        if not shifts.enough.any():
            return None
        grid, fit, moments = self.grid, self.fit, self.moments
        limit = margin * shifts.limit(significance)
        best = int(np.argmax(np.where(shifts.enough, shifts.squared, 0.0)))
        near = self.at(shifts.about(best))
        k = int(np.argmax(near.squared))
        squared = float(near.squared[k])
        left = max(1.0, (fit.chi2 - squared) / max(fit.dof - 1, 1))
        value = float(np.sqrt(squared / left))
        if value < max(limit, float(np.abs(np.where(grid.used, fit.test_value, 0.0)).max())):
            return None
        begins = near.at[k]
        return Jump(
            segment=int(moments.segment[begins]),
            row=int(grid.row[moments.strip[begins], moments.target[begins]]),
            size=float(near.score[k] / near.information[k]),
            std=float(np.sqrt(left / near.information[k])),
            value=value,
        )


@dataclass(frozen=True, eq=False)
class Slips:
    """Slips of ``size`` (m), one fringe, that begin at the moments of ``shifts``.

    ``missed`` (t,): probability that nothing is found of a slip at each of them. ``chance`` (t,):
    how probably a slip begins there and stays unseen.
    """

    size: float
    shifts: Shifts
    missed: Floats
    chance: Floats

    @property
    def found(self) -> float:
        """How probably a slip at any moment is found."""
        return 1.0 - float(self.missed.mean())

    def covariance(self) -> Floats:
        """Return what unseen slips add to the covariance (q, q) of what the shifts move, SI."""
        moved = self.size * self.shifts.moved
        return np.asarray((moved.T * self.chance) @ moved, dtype=np.float64)

    def protection(self, moved: Floats, std: Floats, cure: str = "") -> Protection:
        """Return the statement about slips.

        ``moved`` (t, o): what a shift of a metre at each moment does to the outputs, which have
        the standard uncertainties ``std`` (o,). A slip that may do more than TOLERABLE where it
        is not found with POWER is named, although the uncertainty holds it on average; ``cure`` is
        added then.
        """
        share = largest_share(self.size * moved, std)
        hidden = share[self.missed > 1.0 - POWER]
        worst = float(hidden.max()) if hidden.size else 0.0
        what = f"a counter that slips a fringe of {self.size:.3g} m"
        why = (
            f"{what} is found in {100 * self.found:.0f} % of the cases, by these lengths in this "
            "order; the uncertainty holds what the others do"
        )
        if worst > TOLERABLE:
            return Protection("slip", "not protected", f"{why} on average{cure}", worst)
        if self.found >= POWER:
            why = f"{what} makes the lengths disagree, and is found"
            return Protection("slip", "tested", why, worst)
        return Protection("slip", "bounded", why, worst)

    def draw(self, grid: Grid, rng: np.random.Generator, count: int) -> Floats:
        """Return what unseen slips do to the lengths of ``count`` trials, (count, p, n) in m."""
        chance, at = self.chance, self.shifts.at
        which = np.searchsorted(np.cumsum(chance), rng.random(count), "right")
        sign = np.where(rng.random(count) < 0.5, -self.size, self.size)
        shift = np.zeros((count, *grid.used.shape))
        hit = np.flatnonzero(which < len(at))
        if len(hit):
            later: Bools = self.shifts.moments.later(grid, at[which[hit]])
            shift[hit] = sign[hit, None, None] * later
        return shift


def largest_share(moved: Floats, std: Floats) -> Floats:
    """Return the largest of moves (k, o) of the outputs in their uncertainties (o,): (k,).

    Outputs without uncertainty do not count.
    """
    uncertain = std > 0.0
    return np.asarray((np.abs(moved[:, uncertain]) / std[uncertain]).max(axis=1, initial=0.0))


def slips_among(
    shifts: Shifts | None,
    size: float,
    significance: float,
    scale: float = 1.0,
    *,
    asked: bool = False,
) -> Slips | None:
    """Return slips of ``size`` (m) that a test of ``significance`` may miss.

    None without ``shifts``, or of size 0.

    ``scale``: how much larger the noise of all lengths is than their network has it. ``asked``:
    the lengths say how probable each slip is, by Bayes' theorem; else that is stated beforehand.
    """
    if shifts is None or not size or not len(shifts.at):
        return None
    apart = size * np.sqrt(shifts.information) / scale
    found = ndtr(apart - shifts.limit(significance))
    missed = np.where(shifts.enough, 1.0 - found, 1.0)
    chance = SLIPPED / len(missed) * missed
    if asked:
        score = size * shifts.score / scale**2
        ratio = np.logaddexp(score, -score) - np.log(2.0) - 0.5 * apart**2
        largest = max(float(ratio.max()), 0.0)
        odds = SLIPPED / len(missed) * np.exp(ratio - largest)
        chance = odds / ((1.0 - SLIPPED) * np.exp(-largest) + odds.sum())
    return Slips(size, shifts, missed, chance)


def zeros_in_time(
    entries: Iterable[tuple[dict[str, Any], int, int, int]], value: Floats, covariance: Floats
) -> list[dict[str, Any]]:
    """Return the ``entries`` of unbroken beams, in the order of time, with their zeros.

    Each comes with the place where the tracer stood, and its first and last zero. ``value`` (s,),
    m, ``covariance`` (s, s) of all zeros. By how much a zero is larger than the one before it at
    the same place, and how probable such a step is by chance, is stated from the second one on.
    """
    found, before = [], dict[int, int]()
    for entry, place, first, last in entries:
        std = float(np.sqrt(covariance[first, first]))
        beam = {**entry, "zero": float(value[first]), "std": std}
        if place in before:
            pair = [before[place], first]
            step = float(value[first] - value[pair[0]])
            (a, b), (_, c) = covariance[np.ix_(pair, pair)].tolist()
            variance = c + a - 2 * b
            beam |= {
                "step": step,
                "step_std": float(np.sqrt(variance)),
                "probability": chi2_sf(step**2 / variance, 1.0),
            }
        found.append(beam)
        before[place] = last
    return found
