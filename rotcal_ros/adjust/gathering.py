"""What was found to gather, kept from step to step, and said in words: the same for all methods.

A method hands over its groups and its :class:`Words`; here they are judged, what is found is kept
in a :class:`Gathering`, and reported. What is proved the method leaves out; what is only
probable joins the covariance.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import binomial_quantile
from rotcal_ros.adjust.groups import Group, GroupTest, JudgedWhole, group_test
from rotcal_ros.adjust.judgement import BELIEF, Belief, Blame, Judgement, blame, judge
from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.units import MICROMETRE

RARE: Final = 0.05
"""Probability that single outliers by chance are as many as are called off together."""
SUSPECTED: Final = 0.015
"""Probability of suspecting sound data of what cannot be proved."""


class Words(NamedTuple):
    """How people call the elements of groups (``lengths``), and what spoils them together.

    ``cause``: what to look for, ``where``: what it is about, as "in the beams", ``its``: of one
    group, as "in its beams". Sizes are shown in ``unit``, ``unit_si`` in SI.
    """

    elements: str
    cause: str
    where: str
    its: str
    unit: str = "um"
    unit_si: float = MICROMETRE

    @property
    def contradicts(self) -> str:
        """What is said of an effect that other elements would show."""
        return f"contradicts other {self.elements}"

    def size(self, size: Floats) -> str:
        """Return a ``size`` (c,), SI, for people."""
        return " ".join(f"{x / self.unit_si:+.2g}" for x in size.tolist()) + f" {self.unit}"


class GatheringLimits(NamedTuple):
    """How many of a group may be rejected by chance, and how rarely tests alarm on sound data.

    ``significance``: of the test of groups; ``suspected``: of what cannot be proved.
    """

    rejected_share: float
    significance: float
    suspected: float = SUSPECTED


class Count(NamedTuple):
    """How one group fared: its test, and how many elements there were and were rejected."""

    kind: str
    name: str
    test: GroupTest
    whole: int
    lost: int


@dataclass(frozen=True, eq=False)
class Gathering:
    """What was found to gather.

    ``judgement``: of what is left, None where nothing was judged. ``blamed``: what was left out,
    in the order in which it was found. ``counts``: all groups with the elements that are left.
    ``contested``: a single outlier was kept, for several that are off together explain it as well.
    """

    judgement: Judgement | None = None
    blamed: tuple[Blame, ...] = ()
    counts: tuple[Count, ...] = ()
    contested: bool = False

    @property
    def chance(self) -> float:
        """How probably sound data look as much as if something gathered."""
        return 1.0 if self.judgement is None else self.judgement.chance

    def proved(self, significance: float, belief: Belief = BELIEF) -> Blame | None:
        """Return what of the most suspicious group is proved to be wrong; None: nothing is."""
        found = self.judgement
        if found is None or not found.proved(significance):
            return None
        return blame(found.groups[found.worst], belief)

    def without(self, case: Blame) -> Gathering:
        """Return it with ``case`` left out, too."""
        return replace(self, blamed=(*self.blamed, case))

    def covariance(self) -> Floats | None:
        """Return what they may add to the covariance (o, o) of the outputs; None: nothing."""
        added = [case.covariance for case in self.blamed]
        if self.judgement is not None and self.judgement.possible:
            added.append(self.judgement.covariance())
        return np.asarray(sum(added[1:], added[0])) if added else None


def judged(
    before: Gathering,
    groups: Sequence[Group | JudgedWhole],
    rest: tuple[float, float] | None,
    weighed: Sequence[Group] | None = None,
    belief: Belief = BELIEF,
    common: Collection[str] = (),
) -> Gathering:
    """Return ``before`` with what ``groups`` say.

    ``rest`` as in :func:`~.groups.group_test`. ``weighed``: of which it is asked what gathers in
    them; None: those that name subsets. All are tested, but of kinds that all scatter beyond
    chance (``common``) no single group is called improbable.
    """
    counts = tuple(
        Count(
            g.kind,
            g.name,
            replace(test, probability=1.0) if g.kind in common else test,
            g.size + g.lost,
            g.lost,
        )
        for g, test in ((g, group_test(g, rest)) for g in groups)
    )
    if weighed is None:
        weighed = [g for g in groups if isinstance(g, Group) and len(g.gathered)]
    found = judge(weighed, belief, rest)
    return replace(before, judgement=found, counts=counts, contested=False)


def doubts(gathering: Gathering, limits: GatheringLimits, words: Words) -> list[str]:
    """Return a sentence about everything that gathers, and about groups that do not fit."""
    found = [_blamed(case, words) for case in gathering.blamed if _many(case, limits)]
    named = {case.group.name for case in gathering.blamed}
    judgement = gathering.judgement
    suspected = gathering.contested or gathering.chance < limits.suspected
    if judgement is not None and suspected:
        name = judgement.groups[judgement.worst].name
        why = (
            f"one of the {words.elements} of {name} does not fit, and some of them that are off "
            "together explain it as well"
            if gathering.contested
            else f"the {words.elements} of {name} look as if some of them were off together (p = "
            f"{gathering.chance:.2g} on sound {words.elements})"
        )
        found.append(
            f"{why}, which ones is not certain: the uncertainty holds what that may do; look for "
            f"{words.cause} {words.its}, and measure it again"
        )
    return found + _counted(gathering.counts, named, limits, words)


def protection(
    worst: Hidden, what: str, size: str, *, searched: str = "", beside: str = ""
) -> Protection:
    """Return the statement about ``what`` is off together, of which ``worst`` may stay unseen.

    ``size``: that of the worst, for people. ``searched``: where it is looked for, ``beside``: what
    else is said.
    """
    if not worst.seen:
        return Protection("one place", "not protected", f"{what} leave no residual")
    why = (
        f"{what} are looked for{searched}; {worst.count} of {worst.name} by {size} are found, the "
        f"worst case{beside}"
    )
    return Protection("one place", "tested", why, worst.error)


def _many(case: Blame, limits: GatheringLimits) -> bool:
    """Whether so many are off together that it is no matter of single outliers."""
    whole = case.group.size + case.group.lost
    usual = binomial_quantile(1.0 - RARE, whole, limits.rejected_share)
    return int(case.subset.sum()) > usual


def _blamed(case: Blame, words: Words) -> str:
    count = int(case.subset.sum())
    text = (
        f"{count} of the {case.group.size + case.group.lost} {words.elements} of "
        f"{case.group.name} are off together, by about {words.size(case.size)}, and were left "
        f"out: look for {words.cause} {words.where}"
    )
    if case.ambiguous:
        other = int(case.rivals[0].sum())
        text += "; " + (
            f"that {other} others are off in their place explains the residuals nearly as well "
            f"(likelihood 1 : {case.ratios[0]:.2g}), and the uncertainty covers both"
        )
    return text


def _counted(
    counts: Sequence[Count], named: set[str], limits: GatheringLimits, words: Words
) -> list[str]:
    """Return sentences about groups whose rejected share or chi-squared is no chance."""
    found = []
    significance = 1.0 - (1.0 - limits.significance) ** (1.0 / max(len(counts), 1))
    for row in counts:
        if row.name in named:
            continue
        if row.lost and row.lost > binomial_quantile(
            1.0 - significance, row.whole, limits.rejected_share
        ):
            found.append(
                f"{row.lost} of the {row.whole} {words.elements} of {row.name} were rejected, "
                "which is no chance: something is wrong with all of it; measure it again"
            )
        elif row.test.probability < significance:
            root = float(np.sqrt(row.test.squares / max(row.test.rank, 1)))
            found.append(
                f"the {words.elements} of {row.name} disagree {root:.2g} times as much as those "
                f"of others (chi-squared, p = {row.test.probability:.2g}): something was wrong "
                "there"
            )
    return found


def details(gathering: Gathering, elements: str) -> dict[str, Any]:
    """Return what was found for the details of a result; sizes in SI.

    ``chance``: how probably sound data look as much as if something gathered. ``groups``: the test
    of every group, ``blamed``: what was left out together; ``elements`` is the key of numbers.
    """
    return {
        "chance": gathering.chance,
        "groups": [
            {
                "name": row.name,
                "squares": row.test.squares,
                "rank": row.test.rank,
                "probability": row.test.probability,
                "redundancy": row.test.redundancy,
                elements: row.whole,
                "rejected": row.lost,
            }
            for row in gathering.counts
        ],
        "blamed": [
            {
                "name": case.group.name,
                elements: int(case.subset.sum()),
                "size": float(np.linalg.norm(case.size)) * _sign(case.size),
                "likelihood_ratio": float(case.ratios[0]) if len(case.ratios) else None,
            }
            for case in gathering.blamed
        ],
    }


def _sign(size: Floats) -> float:
    """Return the sign of a size (1,) along one axis; +1 for the length of several."""
    return -1.0 if size.size == 1 and size[0] < 0.0 else 1.0
