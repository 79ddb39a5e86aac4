"""What was found to gather, kept from step to step, and said in words: the same for all methods.

A method hands over its groups and its :class:`Words`; here they are judged, what is found is kept
in a :class:`Gathering`, and reported. What is proved the method leaves out; what is only
probable joins the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import binomial_quantile, sidak
from rotcal_ros.adjust.groups import Group, GroupTest, JudgedGroup, group_tests
from rotcal_ros.adjust.judgement import BlamedSubset, Judgement, judge
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.compact import FULL, CompactCovariance, Spread
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import Unit
AS_WELL: Final = noted(
    "that {0} others are off in their place explains the residuals nearly as well (likelihood 1 "
    ": {1:.2g}), and the uncertainty covers both"
)
OFF_TOGETHER: Final = noted(
    "{0} of the {1} {2} of {3} are off together, by about {4}, and were left out: look for {5} {6}"
)

RARE: Final = 0.05
"""Probability that single outliers by chance are as many as are called off together."""
SUSPECTED: Final = 0.015
"""Probability of suspecting sound data of what cannot be proved."""


class Words(NamedTuple):
    """How people call the elements of groups (``lengths``), and what spoils them together.

    ``cause``: what to look for, ``where``: what it is about, as "in the beams", ``its``: of one
    group, as "in its beams".
    """

    elements: str
    cause: str
    where: str
    its: str

    @property
    def contradicts(self) -> Phrase:
        """What is said of an effect that other elements would show."""
        return phrase("contradicts other {0}", phrase(self.elements))


class Count(NamedTuple):
    """How one group fared: its test, and how many elements there were and were rejected."""

    kind: str
    name: Phrase
    test: GroupTest
    whole: int
    lost: int


@dataclass(frozen=True, eq=False)
class Gathering:
    """What was found to gather.

    ``judgement``: of what is left, None where nothing was judged. ``blamed``: what was left out,
    in the order in which it was found. ``counts``: all groups with the elements that are left.
    """

    judgement: Judgement | None = None
    blamed: tuple[BlamedSubset, ...] = ()
    counts: tuple[Count, ...] = ()

    @property
    def false_alarm_probability(self) -> float:
        """How probably sound data look as much as if something gathered."""
        return 1.0 if self.judgement is None else self.judgement.false_alarm_probability

    def without(self, case: BlamedSubset) -> Gathering:
        """Return it with ``case`` left out, too."""
        return replace(self, blamed=(*self.blamed, case))

    def covariance(self) -> Spread | None:
        """Return what they may add to the covariance (o, o) of the outputs; None: nothing."""
        roots = [case.root for case in self.blamed]
        together = np.hstack(roots) if roots else None
        if self.judgement is None or not self.judgement.possible:
            return None if together is None else _products(together)
        gathers = self.judgement.covariance()
        if together is None:
            return gathers
        if isinstance(gathers, CompactCovariance):
            return gathers.plus(CompactCovariance.shared(together))
        return np.asarray(gathers + together @ together.T)


def judge_gathering(
    before: Gathering,
    groups: Sequence[Group | JudgedGroup],
    rest: tuple[float, float] | None,
) -> Gathering:
    """Return ``before`` with what ``groups`` say; ``rest`` as in :func:`~.groups.group_tests`.

    All are tested; of those that name subsets it is asked what gathers in them.
    """
    each = zip(groups, group_tests(groups, rest), strict=True)
    counts = [Count(g.kind, g.name, test, g.size + g.lost, g.lost) for g, test in each]
    weighed = [g for g in groups if isinstance(g, Group) and len(g.gathered)]
    return replace(before, judgement=judge(weighed, rest), counts=tuple(counts))


def gathering_doubts(
    gathering: Gathering, rejected_share: float, significance: float, words: Words, unit: Unit
) -> Iterator[Phrase]:
    """Yield a sentence about everything that gathers, and about groups that do not fit.

    ``rejected_share``: how many of a group may be rejected by chance; ``significance``: of the
    test of groups.
    """
    for case in gathering.blamed:
        whole = case.group.size + case.group.lost
        # so many are no matter of single outliers
        if case.subset.sum() > binomial_quantile(1.0 - RARE, whole, rejected_share):
            yield _blamed(case, words, unit)
    named = {case.group.name for case in gathering.blamed}
    judgement = gathering.judgement
    if judgement is not None and gathering.false_alarm_probability < SUSPECTED:
        name = judgement.groups[judgement.worst].name
        why = phrase(
            "some {0} of {1} appear to be off together (p = {2:.2g} for sound {3})",
            phrase(words.elements), name, gathering.false_alarm_probability, phrase(words.elements)
        )  # fmt: skip
        yield phrase(
            "{0}; it is uncertain which, and U includes it; look for {1} {2}, and "
            "measure it again", why, phrase(words.cause), phrase(words.its)
        )  # fmt: skip
    yield from _counted(gathering.counts, named, rejected_share, significance, words)


def _blamed(case: BlamedSubset, words: Words, unit: Unit) -> Phrase:
    count = int(case.subset.sum())
    size = " ".join(f"{x / unit.si:+.2g}" for x in case.size.tolist()) + f" {unit.name}"
    text = phrase(
        OFF_TOGETHER,
        count,
        case.group.size + case.group.lost,
        phrase(words.elements),
        case.group.name,
        size,
        phrase(words.cause),
        phrase(words.where),
    )
    if case.ambiguous:
        other = int(case.rivals[0].sum())
        rival = phrase(AS_WELL, other, case.ratios[0])
        return join_texts([text, rival])
    return text


def _counted(
    counts: Sequence[Count],
    named: set[Phrase],
    rejected_share: float,
    significance: float,
    words: Words,
) -> Iterator[Phrase]:
    """Yield sentences about groups whose rejected share or chi-squared is no chance."""
    each = sidak(significance, max(len(counts), 1))
    for row in counts:
        if row.name in named:
            continue
        if row.lost and row.lost > binomial_quantile(1.0 - each, row.whole, rejected_share):
            yield phrase(
                "{0} of the {1} {2} of {3} were rejected, more than by chance: something "
                "affected all of it; measure it again", row.lost, row.whole,
                phrase(words.elements), row.name
            )  # fmt: skip
        elif row.test.probability < each:
            root = float(np.sqrt(row.test.squares / max(row.test.rank, 1)))
            yield phrase(
                "the {0} of {1} disagree {2:.2g} times as much as those of others (chi-squared, "
                "p = {3:.2g}): something was wrong there", phrase(words.elements), row.name, root,
                row.test.probability
            )  # fmt: skip


def gathering_details(gathering: Gathering, elements: str) -> dict[str, Any]:
    """Return what was found for the details of a result; sizes in SI.

    ``chance``: how probably sound data look as much as if something gathered. ``groups``: the test
    of every group, ``blamed``: what was left out together; ``elements`` is the key of numbers.
    """
    return {
        "chance": gathering.false_alarm_probability,
        "groups": [
            {
                "name": row.name.text,
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
                "name": case.group.name.text,
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


def _products(root: Floats) -> Spread:
    """Return ``root`` (o, s) times its transposed, as it is kept."""
    return CompactCovariance.shared(root) if len(root) > FULL else np.asarray(root @ root.T)
