"""The rule of a quick check: whether an earlier curve is still within a limit of the table.

With e_j the error of the earlier curve at angle j today (the table as it is, less the curve), its
measured value d_j = e_j + noise and the standard uncertainty u_j of the *new* measurement alone:

* *still valid* when |d_j| <= x - k u_j at all angles, k the normal quantile of the risk of a miss.
  If any |e_j| exceeds x this happens with at most that risk, whatever the other angles and the
  correlations: every angle has to pass a test of its own (intersection-union test, Berger 1982;
  for two limits Schuirmann 1987). No assumption about the table is needed. k u_j is the
  guard band of ISO 14253-1.
* *changed* when some |d_j| > min(c s_j, x + c u_j). s_j holds, beside the new measurement, the
  uncertainty of the earlier curve and the stated ageing; c shares the risk of a false alarm among
  both signs and all angles (Bonferroni). The first means that the table has moved more than that
  explains, the second that it is surely beyond x. A table that has only aged as stated, and lies
  within x, meets either with no more than the risk: knowing that it lies within x only makes large
  differences rarer (Gaussian correlation inequality, Royen 2014).
* *undecided* otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError

RISK: Final = 0.05
"""Risk of a miss and of a false alarm, unless stated otherwise."""


@dataclass(frozen=True)
class CheckRule:
    """The question: ``limit`` x (rad or m), and the accepted risks of a wrong answer.

    ``miss``: of *still valid* although the curve is off by more than the limit somewhere.
    ``false_alarm``: of *changed* although the table has aged no more than stated and lies within
    the limit. ``ageing_std``: standard deviation of the change of each angle since the earlier
    measurement that is nothing unusual, in the unit of the limit. Raises ConfigurationError.
    """

    limit: float
    miss: float = RISK
    false_alarm: float = RISK
    ageing_std: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be risks, a limit or an ageing."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("miss", "false_alarm") and not 0.0 < value < 0.5:
                raise ConfigurationError(
                    f"the risk {field.name} is {value}: expected more than 0 and less than 0.5"
                )
        if not (np.isfinite(self.limit) and self.limit > 0.0):
            raise ConfigurationError(f"the limit is {self.limit}: expected a positive number")
        if not (np.isfinite(self.ageing_std) and self.ageing_std >= 0.0):
            raise ConfigurationError(f"the ageing is {self.ageing_std}: expected zero or more")

    def expected(self, earlier: Floats, keep: Floats) -> Floats:
        """Return the covariance (n, n) of the usual error of the earlier curve.

        ``earlier`` (n, n) is the covariance of the earlier curve, ``keep`` (n, n) the projection
        that removes what neither measurement knows.
        """
        aged = earlier + self.ageing_std**2 * np.eye(len(earlier))
        return np.asarray(keep @ aged @ keep, dtype=np.float64)

    def acceptance(self, new_std: Floats) -> Floats:
        """Return the |d| (n,) up to which an angle passes; below zero none does."""
        return np.asarray(self.limit - normal_isf(self.miss) * new_std, dtype=np.float64)

    def alarm(self, new_std: Floats, expected_std: Floats) -> Floats:
        """Return the |d| (n,) beyond which an angle has changed.

        ``expected_std`` (n,) are the standard deviations of :meth:`expected`.
        """
        share = normal_isf(self.false_alarm / (2 * len(new_std)))
        explained = share * np.hypot(new_std, expected_std)
        return np.asarray(np.minimum(explained, self.limit + share * new_std), dtype=np.float64)

    def assurance(self, new_std: Floats, expected_std: Floats) -> float:
        """Return the least probability that a table that only aged is found still valid.

        It is the product over the angles, which no correlation makes smaller (Sidak 1967).
        """
        spread = np.maximum(np.hypot(new_std, expected_std), np.finfo(np.float64).tiny)
        ratio = np.maximum(self.acceptance(new_std), 0.0) / spread
        return float(np.prod(2.0 * ndtr(ratio) - 1.0))

    def smallest_limit(self, new_std: Floats, expected_std: Floats) -> float:
        """Return the limit at which the assurance is 1 - false alarm."""
        wide = 12.0 * float(np.max(np.hypot(new_std, expected_std)) + np.max(new_std))

        def short(limit: float) -> float:
            reached = replace(self, limit=limit).assurance(new_std, expected_std)
            return reached - 1.0 + self.false_alarm

        return float(brentq(short, 1e-6 * wide, wide, rtol=1e-9))
