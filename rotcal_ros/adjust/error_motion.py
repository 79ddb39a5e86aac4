"""How the error motion of a rotary axis is spread over orders: of few undulations, or of many.

A motion of the order k has k undulations in a turn, a cos(k theta) + b sin(k theta) with a and b
of one variance. The same size in one low order and in all of them (white) are very different
witnesses: n angles see n independent values of white motion, and two of one order. Order 0 belongs
to the axis average line (ISO 230-7), as what turns with the table does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints

HIGHEST: Final = 10
"""Order up to which a motion is held to be one of low orders."""
ROUNDED: Final = 1e-9
"""By which shares may miss a whole."""


@dataclass(frozen=True)
class Spectrum:
    """Shares of the variance of a motion: of each of the ``orders``, and of a ``white`` rest.

    ``shares`` belong to the orders; all together are 1. Raises ValueError for others.
    """

    orders: tuple[int, ...] = ()
    shares: tuple[float, ...] = ()
    white: float = 0.0

    def __post_init__(self) -> None:
        """Refuse shares that are no parts of a whole."""
        every = (*self.shares, self.white)
        if len(self.orders) != len(self.shares) or min(self.orders, default=1) < 1:
            raise ValueError(f"orders {self.orders} from 1 on with as many shares {self.shares}")
        if min(every) < 0.0 or abs(sum(every) - 1.0) > ROUNDED:
            raise ValueError(f"shares {self.shares} and white {self.white}: expected a whole of 1")

    @classmethod
    def of_sizes(cls, sizes: Sequence[float]) -> Spectrum:
        """Return the spectrum whose orders 1, 2, 3 ... have ``sizes`` in relation to each other.

        Raises ValueError where none is above zero.
        """
        squares = np.square(sizes)
        if not squares.sum() > 0.0:
            raise ValueError(f"sizes {tuple(sizes)}: expected at least one above 0")
        shares = squares / squares.sum()
        kept = np.flatnonzero(shares)
        return cls(tuple((kept + 1).tolist()), tuple(shares[kept].tolist()))

    @classmethod
    def falling(cls, lowest: int, highest: int = HIGHEST) -> Spectrum:
        """Return the one whose sizes fall as 1 / k from the ``lowest`` order to ``highest``."""
        order = np.arange(1, highest + 1)
        return cls.of_sizes(np.where(order < lowest, 0.0, 1.0 / order).tolist())

    @classmethod
    def one_each(cls, highest: int = HIGHEST) -> Iterator[Spectrum]:
        """Yield white, and each single order up to the ``highest``.

        Every other spectrum of these is a mean of them, and so is what it does to a variance: who
        holds the worst of them holds all.
        """
        yield WHITE
        yield from (cls((order,), (1.0,)) for order in range(1, highest + 1))

    @classmethod
    def mean(cls, shares: Mapping[Spectrum, float]) -> Spectrum:
        """Return the mean of spectra, of each with a share that is 1 in all."""
        whole: dict[int, float] = {}
        for spectrum, share in shares.items():
            for order, own in zip(spectrum.orders, spectrum.shares, strict=True):
                whole[order] = whole.get(order, 0.0) + share * own
        white = sum(share * spectrum.white for spectrum, share in shares.items())
        return cls(tuple(whole), tuple(whole.values()), white)

    def root(self, angles: Floats) -> Floats:
        """Return columns (n, r) of a motion of size 1 at ``angles`` (n,), rad, of least number.

        Their products add up to its covariance, the sum of share cos(order (theta_i - theta_j));
        white motion is at each of the angles its own.
        """
        phase = np.outer(angles, self.orders)
        size = np.sqrt(self.shares)
        columns = [size * np.cos(phase), size * np.sin(phase)]
        if self.white:
            columns.append(np.sqrt(self.white) * np.eye(len(angles)))
        return np.concatenate(columns, axis=1)


WHITE: Final = Spectrum(white=1.0)
"""A motion that is another at every angle."""


@dataclass(frozen=True, eq=False)
class Correlated:
    """What the errors of some ``rows`` (k,) of a model have in common, per standard deviation.

    They are sums of independent ``parts``, as of radial and axial motions. Each part is one of
    several ways, roots (k, r) whose products are its covariance; which one is not known.
    """

    rows: Ints
    parts: tuple[tuple[Floats, ...], ...]

    def below(self, count: int) -> Correlated:
        """Return the same below ``count`` further rows, in a model where all ways are possible."""
        return Correlated(self.rows + count, self.parts)

    def divided(self, _std: Floats) -> Correlated:
        """Return the same of rows in their standard deviations ``std`` (n,): what it is, too."""
        return self

    def planned(self) -> Correlated:
        """Return the same where no data say which ways are likely."""
        return self.below(0)

    def spread_of(self, fit: Any, influence: Floats) -> Floats:
        """Return :meth:`spread` of the ways that a ``fit`` leaves possible."""
        return self.spread(influence, self.possible(fit))

    def possible(self, _fit: Any) -> Bools:
        """Return which ways (w, v, ...) a fit of the model leaves possible together: all."""
        return np.ones([len(ways) for ways in self.parts], np.bool_)

    def spread(self, influence: Floats, possible: Bools) -> Floats:
        """Return what independent errors would have to do (o, k) in the place of these.

        ``influence`` (o, k): what errors of the rows do to outputs. The variance of each output is
        that of the worst of the ``possible`` ways (w, v, ...), its correlations are those of the
        mean of all that are in one of them.
        """
        chosen, every = np.nonzero(possible), range(possible.ndim)
        variance, mean = np.zeros((len(chosen[0]), len(influence))), np.zeros(2 * [len(self.rows)])
        for part, (ways, mine) in enumerate(zip(self.parts, chosen, strict=True)):
            variance += np.array([((influence @ root) ** 2).sum(axis=1) for root in ways])[mine]
            others = tuple(k for k in every if k != part)
            kept = np.flatnonzero(possible.any(axis=others)).tolist()
            for k in kept:
                mean += ways[k] @ ways[k].T / len(kept)
        size, axes = np.linalg.eigh(mean)
        spread = influence @ (axes * np.sqrt(np.maximum(size, 0.0))) @ axes.T
        square, worst = (spread**2).sum(axis=1), variance.max(axis=0)
        factor = np.sqrt(np.where(square > 0.0, worst, 0.0) / np.where(square > 0.0, square, 1.0))
        return np.asarray(spread * factor[:, None])
