"""How large an effect of a disturbance may be that no test sees: external reliability.

Baarda (1968): an error is detectable from the size on at which its test finds it with a stated
power; carried to the outputs, in their standard uncertainties, that is what stays hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import detectable_size
from rotcal_ros.adjust.explanations import Hypotheses
from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.judgement import Judgement
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats

UNSEEN: Final = 1e-9
"""Information of a shift, per that of its elements alone, below which nothing shows it."""
SAFELY: Final = 1.0 + 1e-9
"""Factor on a bound, for its rounding."""


@dataclass(frozen=True, slots=True)
class UndetectableShift:
    """The worst that may stay unseen of a shift of elements that gather in one group.

    ``error``: the largest change of an output in its standard uncertainty, of a shift of ``size``
    (in its own unit) of ``count`` elements in the group ``name``; ``seen``: some test finds it.
    """

    error: float
    size: float
    count: int
    name: str
    seen: bool


def largest_undetectable_shift(
    judgement: Judgement, std: Floats, significance: float, power: float, largest: float
) -> UndetectableShift | None:
    """Return the worst of all gathered subsets; None where no group has one.

    ``std`` (o,): standard uncertainties of the outputs; zero: one that does not count.
    ``significance``: that of the test of :meth:`~.judgement.Judgement.proved`, whose limit
    for a shift is 2 ln(1 / significance) and what choosing among all subsets takes away.
    ``largest``: a shift of this size, in its own unit, nobody would overlook.
    """
    many = sum(len(group.gathered) for group in judgement.groups)
    if not many:
        return None
    limit = float(np.sqrt(2.0 * np.log(max(many, 2) / significance)))
    every = zip(judgement.groups, judgement.gathered, judgement.freedom, strict=True)
    unseen = [
        _Undetected.of(group, found, detectable_size(limit, power, dof), largest)
        for group, found, dof in every
        if len(group.gathered)
    ]
    reach = _Reach.of(unseen[0].found.group.sensitivity, std)
    most = np.array([reach.most(each) for each in unseen])
    found, reached = dict[int, UndetectableShift](), 0.0
    for k in np.argsort(-most, kind="stable").tolist():
        if SAFELY * most[k] < reached:
            break
        found[k] = unseen[k].worst(std)
        reached = max(reached, found[k].error)
    # of equals the first, whatever their rounding
    return next(here for _, here in sorted(found.items()) if SAFELY * here.error >= reached)


@dataclass(frozen=True, eq=False)
class _Undetected:
    """The gathered subsets of a ``group``, and the sizes (q, c) up to which no test sees them.

    ``seen`` (q, c): a larger one is found; else nobody would overlook it.
    """

    group: Group
    found: Hypotheses
    size: Floats
    seen: Bools

    @classmethod
    def of(cls, group: Group, found: Hypotheses, needed: float, largest: float) -> _Undetected:
        alone = group.gathered.astype(np.float64) @ (group.relative**2).sum(axis=1)
        checked = found.values > UNSEEN * alone[:, None]
        size = np.where(checked, needed / np.sqrt(np.where(checked, found.values, 1.0)), np.inf)
        seen = size * group.usual_std <= largest
        return cls(group, found, np.where(seen, size, largest / group.usual_std), seen)

    def worst(self, std: Floats) -> UndetectableShift:
        """Return the worst of the subsets; ``std`` (o,) of the outputs."""
        group, error = self.group, self.found.reach(std) * self.size
        q, axis = np.unravel_index(int(np.argmax(error)), error.shape)
        return UndetectableShift(
            float(error[q, axis]),
            float(self.size[q, axis] * group.usual_std),
            int(group.gathered[q].sum()),
            group.name,
            bool(self.seen[q, axis]),
        )


@dataclass(frozen=True, eq=False)
class _Reach:
    """What the outputs feel at most, so that few groups need to be looked at closely.

    ``std`` (o,). Of the common part over ``std`` no row r has |r x| above ``longest`` |root x|
    (Cauchy and Schwarz); ``root`` None: there is none, and nothing is known beforehand.
    """

    std: Floats
    root: Floats | None
    longest: float

    @classmethod
    def of(cls, sensitivity: Sensitivity, std: Floats) -> _Reach:
        if sensitivity.common is None:
            return cls(std, None, np.inf)
        there = std > 0.0
        rows, root = np.linalg.qr(sensitivity.common[there] / std[there, None])
        longest = np.sqrt((rows**2).sum(axis=1)).max(initial=0.0)
        return cls(std, np.asarray(root), SAFELY * float(longest))

    def most(self, unseen: _Undetected) -> float:
        """Return what the error of no subset exceeds."""
        sensitivity = unseen.found.group.influence()  # of all groups that is much
        if self.root is None or sensitivity.common is None:
            return np.inf
        along, counted = sensitivity.along, self.std[sensitivity.at] > 0.0
        at = sensitivity.at[counted]
        own = (sensitivity.common[at] @ along + sensitivity.own[counted]) / self.std[at, None]
        squares, worst = np.zeros(unseen.size.shape), np.zeros(unseen.size.shape)
        left = len(self.root)  # rows of what all outputs feel come first
        for each in unseen.found.of_many(np.concatenate([self.root @ along, own])):
            squares += (each[:left] ** 2).sum(axis=0)
            np.maximum(worst, np.abs(each[left:]).max(axis=0, initial=0.0), out=worst)
            left = max(left - len(each), 0)
        share = np.maximum(self.longest * np.sqrt(squares), SAFELY * worst)
        return float((share * unseen.size).max())
