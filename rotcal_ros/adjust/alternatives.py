"""Whether the same readings were meant otherwise: of the other sign, counted the other way round.

A mistake of set-up is no effect of some size that could be taken off. It is another model of the
same readings, with the same unknowns, and what speaks for one or the other is how probable each
makes what was read. The motions of a table are stated; of two models the one in which they have to
be far larger is the less probable. A scatter, of readings or of motions, that contradicts what is
stated is estimated for each model by itself: a statement of a wrong size speaks for neither.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.kernels import OPEN
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Effect, Protection

MEANT_OTHERWISE: Final = noted("it looks as if {0} ({1:.1g} : 1): correct it, and solve again")

EXCLUDED: Final = np.log(20.0)
"""ln of how many times as probable readings are as they were taken, where they exclude others."""
SURELY: Final = np.log(1e5)
"""ln of how many times as probable another meaning makes them, where it is held to be true.

More than chance asks for: what is stated of motions is never known well.
"""

MOST: Final = np.log(1e9)
"""ln of odds that are named; what is more says no more."""
LEAST: Final = 0.5
"""Factor on what is stated beforehand, at least."""
SIZES: Final = (1.0, 2.0, 3.0)
"""Sizes of motions in orders, per stated, that are tried: a statement is rough."""
ROUNDS: Final = 4
"""Steps to the solution of a model that is nearly linear, and to its noise."""


class Alternative(NamedTuple):
    """What else readings may be: by a mistake like ``effect`` it holds that ``what``.

    ``model`` makes the model of them; it raises a RotcalError where they cannot be meant so.
    """

    effect: Effect
    what: str
    model: Callable[[], Model]


@dataclass(frozen=True)
class WeighedAlternative:
    """An alternative, and ln of how many times as probable it makes the readings.

    Minus infinity: they cannot be meant so.
    """

    alternative: Alternative
    gain: float


def compare_alternatives(
    as_taken: Model, left_out: Collection[int], alternatives: Iterable[Alternative]
) -> list[WeighedAlternative]:
    """Return what speaks for the ``alternatives``, those first for which there is most.

    All models have the same observations, in one order, and the same unknowns. What is
    ``left_out``, by row, is left out of each, unless it does better with them.
    """
    here = _improbability(as_taken, left_out)

    def gain(other: Alternative) -> float:
        try:
            return 0.5 * (here - _improbability(other.model(), left_out))
        except RotcalError:
            return -np.inf

    each = [WeighedAlternative(other, gain(other)) for other in alternatives]
    return sorted(each, key=lambda other: -other.gain)


def _improbability(model: Model, gone: Collection[int]) -> float:
    """Return -2 ln of the likelihood, with or without what is ``gone``: each costs a size."""
    every = np.ones(len(model.observed))
    if not gone:
        return _restricted(model, every)
    price = 3.0 * len(gone) * float(np.log(len(every)))
    some = np.where(np.isin(np.arange(len(every)), list(gone)), 0.0, 1.0)
    return min(_restricted(model, every), price + _restricted(model, some))


def _restricted(model: Model, used: Floats) -> float:
    """Return -2 ln of the restricted likelihood: what the unknowns take up tells of no noise.

    Patterson and Thompson (1971). The factors on the noise of readings are 1 or more; what is
    stated beforehand may be far too large, too.
    """
    part = model.of_component == np.arange(len(model.components))[:, None]
    least = np.where((part & model.rejectable).any(axis=1), 1.0, LEAST)
    factors, x, found = np.ones(len(part)), model.first, np.inf
    for _ in range(ROUNDS):
        computed, design = model.equations(x)
        weight = used / (model.std * factors[model.of_component])
        columns = dense(design) * weight[:, None]
        length = np.linalg.norm(columns, axis=0)
        length = np.where(length > 0.0, length, 1.0)
        basis, size, ways = np.linalg.svd(columns / length, full_matrices=False)
        determined = size > OPEN * size[0]
        basis = basis[:, determined]
        taken = basis.T @ ((model.observed - computed) * weight)
        x = x + (ways[determined].T @ (taken / size[determined])) / length
        left = (model.observed - computed) * weight - basis @ taken
        redundancy = part @ ((used > 0.0) - (basis**2).sum(axis=1))
        squares = part @ left**2
        found = float(squares.sum() + 2.0 * redundancy @ np.log(factors))
        share = np.where(redundancy > CHECKED, squares / np.maximum(redundancy, CHECKED), 1.0)
        factors = np.maximum(factors * np.sqrt(share), least)
    return found + _in_orders(model, basis, left, factors)


def _in_orders(model: Model, basis: Floats, left: Floats, factors: Floats) -> float:
    """Return what -2 ln of the likelihood falls by where motions are in orders, or 0: no less.

    Each row counts one that is stated by itself: were a motion of one order large by chance, as
    many witnesses of two numbers. ``basis`` (n, r) spans the design, ``left`` (n,) is beside it,
    both white. Rows of motions hold those of an order, of some size, and of all as much as there
    is at least.
    """
    n, fall, squares = basis.shape[1], 0.0, float(left @ left)
    for together in model.correlated:
        rows, weight = together.rows, np.ones(len(left))
        factor = factors[model.of_component[rows[0]]]
        weight[rows] = (factor / LEAST) ** 2
        for ways in zip(*together.parts, strict=True):
            order = np.zeros((len(left), sum(way.shape[1] for way in ways)))
            if 2 * order.shape[1] > len(rows):
                continue  # of as many orders each is one by itself
            order[rows] = np.concatenate(ways, axis=1) / factor
            columns = np.column_stack([basis, order, left]) * np.sqrt(weight)[:, None]
            bordered, at = columns.T @ columns, n + np.arange(order.shape[1])
            bordered[-1, -1] += 1.0  # also where nothing is left
            for before, size in zip((np.inf, *SIZES), SIZES, strict=False):
                bordered[at, at] += size**-2.0 - before**-2.0
                pivots = np.linalg.cholesky(bordered).diagonal()
                of_sizes = len(at) * np.log(size) + np.log(pivots[:-1]).sum()
                of_rows = float(np.log(weight[rows]).sum())
                fall = min(fall, float(pivots[-1] ** 2 - 1.0 - squares + 2.0 * of_sizes - of_rows))
    return fall


def alternative_doubts(weighed: Sequence[WeighedAlternative]) -> Iterator[Phrase]:
    """Return in words that readings were surely meant otherwise."""
    best = next(iter(weighed), None)
    if best is None or best.gain < SURELY:
        return
    alike = _any_of(other for other in weighed if best.gain - other.gain < EXCLUDED)
    yield phrase(MEANT_OTHERWISE, alike, _odds(best.gain))


def _any_of(others: Iterable[WeighedAlternative]) -> Phrase:
    each = [phrase(other.alternative.what) for other in others]
    return reduce(partial(phrase, "{0}, or {1}"), each)


def _odds(gain: float) -> float:
    return float(np.exp(min(gain, MOST)))


def alternative_protections(weighed: Sequence[WeighedAlternative]) -> Iterator[Protection]:
    """Return by effect whether readings that were meant otherwise would show it."""
    for effect in dict.fromkeys(other.alternative.effect for other in weighed):
        mine = [other for other in weighed if other.alternative.effect == effect]
        what, gain = phrase(mine[0].alternative.what), mine[0].gain
        if gain > SURELY:
            yield Protection(effect, "tested", phrase("it was found that {0}", what))
            continue
        if unseen := [other for other in mine if other.gain > -EXCLUDED]:
            why = phrase("the readings do not exclude that {0}", _any_of(unseen))
            yield Protection(effect, "not protected", why)
            continue
        why = phrase("that {0} cannot be: such readings are refused", what)
        if np.isfinite(gain):
            why = phrase("contradicted by the readings ({1:.1g} : 1): {0}", what, _odds(-gain))
        yield Protection(effect, "tested", why)
