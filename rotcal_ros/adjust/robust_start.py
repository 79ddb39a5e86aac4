"""Where the adjustment starts: a solution that gross errors do not bend."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import chdtrc

from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.distributions import sidak
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.adjust.noise import LEAST_REDUNDANCY
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, RotcalError

ROUNDS: Final = 30
"""Reweighted adjustments of the robust start, and concentration steps after them."""
KEPT: Final = 0.6
"""Share of each group that the robust start concentrates on."""
FAR_WORSE: Final = 5.0
"""Times the standard uncertainty that all give an output: a part that does worse misses some."""
GROSS: Final = 5.0
"""Times the limit of an outlier, in the scatter of the others, that bends a start."""
SURELY: Final = 0.1
"""Chance of a kind of groups to scatter as much, from which on something may bend the start."""
ROUGHLY: Final = 1e-8
"""Squared step per chi-squared that is no matter to where the adjustment starts."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""


def robust_start(model: Model, limits: Limits) -> tuple[Floats, Ints]:
    """Return unknowns (p,) that gross errors do not bend, and the observations that are gross.

    Observations that fit as they are need nothing robust. From start values that are too poor for
    that, plain least squares may settle all the same.
    """
    every = np.ones(len(model.observed), dtype=np.bool_)
    try:
        fit = fit_model(model, every, model.std, model.first)
        if _sound(fit, limits):
            return fit.x, np.zeros(0, dtype=np.int64)
    except DataError:
        pass
    try:
        return _unbent(model, limits)
    except DataError:
        return fit_model(model, every, model.std, model.first).x, np.zeros(0, dtype=np.int64)


def _sound(fit: Fit, limits: Limits) -> bool:
    """Whether no element stands out, and no group scatters too much.

    Noise that is larger than stated bends nothing: a component that scatters too much counts by
    the median of its residuals.
    """
    model = fit.model
    white, components = fit.white, len(model.components)
    noisy = _scattering(fit, white, model.of_component, components)
    if noisy.any():
        test, scale = np.abs(fit.test_value), np.ones(components)
        for k in np.flatnonzero(noisy):
            mine = test[model.of_component == k]
            scale[k] = max(float(np.median(mine[mine > 0.0])) / NORMAL_QUARTILE, 1.0)
        white = white / scale[model.of_component]
        loudest = scale[model.of_component[model.elements[:, 0]]]
    else:
        loudest = np.ones(len(model.elements))
    squares, rank = fit.element_test
    if (squares / loudest**2 > limits.of_squares(model, rank)).any():
        return False
    numbers = ((g.number, int(g.number.max(initial=-1)) + 1) for g in model.groupings)
    return not any(_scattering(fit, white, number, count).any() for number, count in numbers)


def _scattering(fit: Fit, white: Floats, number: Ints, count: int) -> Bools:
    """Return which groups (count,) of rows of a ``number`` (n,) scatter more than chance would."""
    mine = number >= 0
    squares = np.bincount(number[mine], white[mine] ** 2, count)
    checked = np.bincount(number[mine], fit.redundancy[mine], count)
    tested = checked > LEAST_REDUNDANCY
    chance = chdtrc(np.where(tested, checked, 1.0), squares)
    return np.asarray(tested & (chance < sidak(SURELY, int(tested.sum()))))


def _unbent(model: Model, limits: Limits) -> tuple[Floats, Ints]:
    n, p = model.size
    every = np.ones(n, dtype=np.bool_)
    # at first each by what it misses the start values by: a gross error cannot pull them away
    miss = np.maximum(np.abs(model.observed - model.equations(model.first)[0]) / model.std, 1.0)
    if model.linearised(model.first)[1].large:
        miss = np.sqrt(miss)  # no more, for what is iterated
    fit = fit_model(model, every, model.std * miss, model.first, settled=ROUGHLY)
    for _ in range(ROUNDS):
        # weights of least absolute deviations, which are those of least squares for small ones
        miss = np.maximum(np.abs(fit.residual) / model.std, 1.0)
        after = fit_model(model, every, model.std * np.sqrt(miss), fit.x, settled=ROUGHLY)
        moved = np.abs((after.residual - fit.residual) / model.std).max()
        fit = after
        if moved < 0.01:
            break
    fit = _concentrated(model, fit)
    miss = np.abs(fit.residual) / model.std
    scatter = max(float(np.median(miss)) / NORMAL_QUARTILE, 1.0)
    gross = (miss > GROSS * limits.outlier(model) * scatter) & model.rejectable
    gross = np.isin(model.of_element, model.of_element[gross])
    try:
        fit_model(model, ~gross, model.std, fit.x, settled=ROUGHLY)
    except RotcalError:
        return fit.x[:p], np.zeros(0, dtype=np.int64)  # too many: they are judged with the rest
    return fit.x[:p], np.flatnonzero(gross)


def _concentrated(model: Model, fit: Fit) -> Fit:
    """Return the fit to the better part of every group, by concentration steps.

    Least trimmed squares (Rousseeuw and Van Driessen 2006). Where that part determines an output
    not at all, or far worse than the whole, the fit stays as it is.
    """
    used, usual = fit.used, fit
    for _ in range(ROUNDS):
        better = _better(model, fit)
        if (better == used).all():
            break
        try:
            after = fit_model(model, better, model.std, fit.x, settled=ROUGHLY)
            if after.is_much_less_precise(usual, FAR_WORSE):
                break
        except RotcalError:
            break
        fit, used = after, better
    return fit


def _better(model: Model, fit: Fit) -> Bools:
    """Return the observations (n,) that miss least in every group of the first grouping."""
    whole, first = model.of_element, model.elements[:, 0]
    count = np.bincount(whole)
    miss = np.sqrt(np.bincount(whole, (fit.residual / model.std) ** 2) / count)
    kept = ~model.rejectable[first]
    number = model.groupings[0].number[first] if model.groupings else np.zeros_like(first)
    for group in np.unique(number):
        each = np.flatnonzero((number == group) & model.rejectable[first])
        better = np.argsort(miss[each], kind="stable")[: int(np.ceil(KEPT * len(each)))]
        kept[each[better]] = True
    return np.asarray(kept[whole])
