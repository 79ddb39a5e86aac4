"""The fewest lengths with which a tracer's quick check is expected to find a good table good.

Wanted is the assurance of :class:`rotcal_ros.planning.check_rule.CheckRule`: a table that has only
aged as stated shall be found still valid with a probability of 1 - false alarm. Targets that all
stations see come first, since only they separate the machine's errors from the table's: they are
added and exchanged as long as that improves, the fewest that suffice are kept, and single lengths
are taken away from them. It finds a good plan, and proves nothing about the best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_design.settings import LEAST_REDUNDANCY
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.policy.exchange import Progress
from rotcal_ros.methods.tracer.policy.information import (
    LEAST_DEPTH,
    Information,
    Lengths,
    Scene,
    Spread,
)
from rotcal_ros.methods.tracer.solver.problem import STATION_MINIMUM
from rotcal_ros.planning.check_rule import CheckRule

SHARPNESS: Final = 4
"""Power by which an angle with a large variance counts more than others in the search."""
UNCHECKED: Final = 20.0
"""How much a lack of redundancy or depth counts in the search, beside the variances."""
BETTER: Final = 1e-3
"""Relative gain for which an exchange is worth its time."""

WAYS: Final = 3
"""How many of the smallest sets of targets lengths are taken away from, to keep the fewest."""


@dataclass(frozen=True, eq=False)
class CheckLengths:
    """The ``lengths`` of a quick check, and what they promise.

    ``std`` (m,): standard uncertainty (rad) of each angle less their mean, error motion with it.
    ``assurance``: probability with which a table that has only aged as stated is found still
    valid. ``least_redundancy`` of any length.
    """

    lengths: Lengths
    std: Floats
    assurance: float
    least_redundancy: float


def fewest_lengths(
    scene: Scene,
    rule: CheckRule,
    expected_std: Floats,
    one_zero: bool = False,
    least_redundancy: float = LEAST_REDUNDANCY,
    progress: Progress | None = None,
) -> CheckLengths:
    """Choose the fewest lengths from the stations to the targets of ``scene`` that suffice.

    ``expected_std`` (m,), rad: how far the earlier curve may usually be off, see
    :meth:`CheckRule.expected`. Every station gets as many lengths as the solver needs, to
    targets that do not lie in a plane, and every length a redundancy of ``least_redundancy``; with
    0 nothing checks the lengths, and an undetected error of one may turn the verdict.
    ``one_zero``: all lengths share their zero.
    Raises PlanError when no choice suffices; the text says which limit could be checked.
    """
    search = _LengthSearch(scene, rule, expected_std, one_zero, least_redundancy)
    search.require_possible()
    ways = [search.pruned(targets) for targets in search.target_sets(progress)[-WAYS:]]
    known = search.known(min(ways, key=len))
    std = np.sqrt(known.variances())
    return CheckLengths(
        lengths=known.lengths,
        std=std,
        assurance=rule.assurance(std, expected_std),
        least_redundancy=float(known.redundancy.min()),
    )


@dataclass(frozen=True, eq=False)
class _LengthSearch:
    """What is asked of a choice of lengths, and the ways to a better one."""

    scene: Scene
    rule: CheckRule
    expected_std: Floats
    one_zero: bool
    least_redundancy: float

    def all_to(self, targets: list[int]) -> Lengths:
        """Return the lengths from every station to ``targets``."""
        m = len(self.scene.stations)
        position = np.repeat(np.arange(m), len(targets))
        return Lengths.of(position, np.tile(targets, m), 0 if self.one_zero else position)

    def known(self, lengths: Lengths) -> Information:
        zeros = 1 if self.one_zero else len(self.scene.stations)
        return Information(self.scene, lengths, zeros)

    def require_possible(self) -> None:
        """Raise PlanError when even exact lengths, or those to all targets, would not suffice."""
        wanted, n = 1.0 - self.rule.false_alarm, len(self.scene.targets)
        if n < STATION_MINIMUM:
            raise PlanError(f"{n} possible targets: offer at least {STATION_MINIMUM}")
        every = self.all_to(list(range(n)))
        if _least_depth(self.scene, every) < LEAST_DEPTH:
            raise PlanError(
                "the possible targets lie nearly in one plane, in which the tracer has a mirror "
                "image: offer some at other heights"
            )
        exact = np.sqrt(np.diagonal(self.scene.error_motion_angles))
        known = self.known(every)
        whole = np.sqrt(known.variances())
        for what, std in (("exact lengths", exact), (f"lengths to all {n} targets", whole)):
            reached = self.rule.assurance(std, self.expected_std)
            if reached < wanted:
                smallest = self.rule.smallest_limit(std, self.expected_std) / self.rule.limit
                raise PlanError(
                    f"even {what} would find a table that has only aged as stated within the "
                    f"limit with a probability of {100 * reached:.3g} % (wanted "
                    f"{100 * wanted:.3g} %): ask for at least {smallest:.2f} times this limit, or "
                    "for other risks, or calibrate anew"
                )
        self.require_checkable(known)

    def require_checkable(self, known: Information) -> None:
        """Raise PlanError when too few lengths would be checked even if all were measured."""
        redundancy = known.redundancy
        checked = known.lengths.position[redundancy >= self.least_redundancy]
        count = np.bincount(checked, minlength=len(self.scene.stations))
        if count.min() < STATION_MINIMUM:
            raise PlanError(
                f"with lengths to all {len(self.scene.targets)} targets measured, table position "
                f"{int(count.argmin())} has {count.min()} with a redundancy of "
                f"{self.least_redundancy:g} (largest {redundancy.max():.2f}), {STATION_MINIMUM} "
                "are needed: check more angles, or accept less redundancy"
            )

    def merit(self, targets: list[int]) -> float:
        """Return what the search makes small: a mean of the variances that favours the largest.

        Lengths that too little checks make it larger, and targets in a plane.
        """
        known = self.known(self.all_to(targets))
        mean = float((known.variances() ** SHARPNESS).mean() ** (1.0 / SHARPNESS))
        unchecked = max(self.least_redundancy - float(known.redundancy.min()), 0.0)
        flat = max(LEAST_DEPTH - _least_depth(self.scene, known.lengths), 0.0)
        return mean * (1.0 + UNCHECKED * (unchecked + flat))

    def met(self, known: Information) -> bool:
        """Whether the lengths of ``known`` do all that is asked."""
        count = np.bincount(known.lengths.position, minlength=len(self.scene.stations))
        if count.min() < STATION_MINIMUM or _least_depth(self.scene, known.lengths) < LEAST_DEPTH:
            return False
        std = np.sqrt(known.variances())
        if self.rule.assurance(std, self.expected_std) < 1.0 - self.rule.false_alarm:
            return False
        return bool(known.redundancy.min() >= self.least_redundancy)

    def target_sets(self, progress: Progress | None) -> list[list[int]]:
        """Return sets of targets whose lengths from all stations suffice, the smallest last."""
        chosen: list[int] = []
        most = len(self.scene.targets)
        while not self.enough(chosen):
            if len(chosen) == most:
                raise PlanError(
                    f"lengths to all {most} targets do not give each a redundancy of "
                    f"{self.least_redundancy:g}: check more angles, or accept less redundancy"
                )
            chosen = self.one_more(chosen)
            if progress is not None:
                progress(len(chosen), most)
        sets = [chosen]
        while len(sets[-1]) > STATION_MINIMUM:
            fewer = self.exchanged(self.one_less_target(sets[-1]))
            if not self.enough(fewer):
                break
            sets.append(fewer)
        return sets

    def enough(self, targets: list[int]) -> bool:
        """Whether the lengths from all stations to ``targets`` suffice."""
        few = len(targets) < STATION_MINIMUM
        return not few and self.met(self.known(self.all_to(targets)))

    def one_less_target(self, chosen: list[int]) -> list[int]:
        """Return ``chosen`` without the target whose loss costs least."""
        without = [chosen[:k] + chosen[k + 1 :] for k in range(len(chosen))]
        return min(without, key=self.merit)

    def one_more(self, chosen: list[int]) -> list[int]:
        """Return ``chosen`` with the target that improves it most."""
        others = sorted(set(range(len(self.scene.targets))) - set(chosen))
        merits = [self.merit([*chosen, t]) for t in others]
        return [*chosen, others[int(np.argmin(merits))]]

    def exchanged(self, chosen: list[int]) -> list[int]:
        """Exchange one target after the other for a better one, until none is found."""
        best = self.merit(chosen)
        waiting = len(chosen)
        while waiting:
            chosen, last = [*chosen[1:], chosen[0]], best
            other = self.one_more(chosen[:-1])
            merit = self.merit(other)
            if merit < last * (1.0 - BETTER):
                chosen, best, waiting = other, merit, len(chosen)
            else:
                waiting -= 1
        return chosen

    def pruned(self, targets: list[int]) -> Lengths:
        """Return the lengths to ``targets`` without those that are not needed."""
        known = self.known(self.all_to(sorted(targets)))
        while (fewer := self.one_less(known)) is not None:
            known = fewer
        return known.lengths

    def one_less(self, known: Information) -> Information | None:
        """Take away the length whose loss costs least among those that can be spared."""
        beams = known.beams(known.lengths)
        left = np.maximum(known.redundancy, 1e-9) * beams.variance
        after = known.variances() + beams.angles**2 / left[:, None]
        for number in np.argsort((after**SHARPNESS).sum(axis=1)).tolist():
            fewer = known.without([number])
            if self.met(fewer):
                return fewer
        return None


def _least_depth(scene: Scene, lengths: Lengths) -> float:
    """Return the smallest depth of the targets of any station."""
    return float(Spread.of(scene, lengths).depth.min())
