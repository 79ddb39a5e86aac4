"""How narrow intervals can be where no scatter is, if they must hold whatever scatter there is.

usage: python benchmarks/six_scatter_bound.py

Any rule chooses its width from the contrasts. Of all of them, also randomised ones, the narrowest
on average is a linear program: which width at which contrasts, so that the wanted share of truths
is held at every kind and size of scatter up to twice the noise-equivalent. Contrasts are taken
together in two groups, those that turns of the table reach and those that they do not, each by its
sum of squares; widths and sums come in steps.
"""

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, kron
from scipy.stats import chi2, norm
from six_coverage import CASES, KINDS
from six_linear import Linear
from six_scene import good_targets

from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT

WANTED = (0.93, 0.95)
LEVELS = np.geomspace(0.25, 2.0, 6)
STEPS = 18
WIDEST = 9.0


def groups(network):
    """Return numbers (2,) of contrasts, and what unit squares add to their variances (2, 2)."""
    shift, turn = network.contrasts.spread
    values, vectors = np.linalg.eigh(turn)
    reached = values > 0.01 * values[-1]
    by_shift = np.einsum("qk,qr,rk->k", vectors, shift, vectors)
    each = [~reached, reached]
    numbers = np.array([int(group.sum()) for group in each])
    slope = [[by_shift[group].mean(), max(values[group].mean(), 0.0)] for group in each]
    return numbers, np.array(slope)


def narrowest(network, component, wanted, smallest):
    """Return the least mean width where there is no scatter, in widths where that is known.

    ``smallest``: half a width, in standard deviations without scatter.
    """
    numbers, slope = groups(network)
    noise = network.shaped((network.noise**2).sum(axis=1)).mean(axis=1)[component]
    felt = [network.shaped(row).mean(axis=1)[component] for row in network.slopes(network.gain)]
    width = np.unique(np.r_[np.linspace(smallest, 2.6, 27), np.linspace(2.6, WIDEST, 22)])
    likely, held = [], []
    for scatter in scatters():
        likely.append(np.outer(*map(_steps, numbers, 1.0 + slope @ scatter)).ravel())
        held.append(2.0 * norm.cdf(width / np.sqrt(1.0 + felt @ scatter / noise)) - 1.0)
    rows = csr_array(np.stack([np.outer(p, h).ravel() for p, h in zip(likely, held, strict=True)]))
    some = len(likely[0])
    found = linprog(
        np.outer(likely[0], width).ravel() / HALF_OF_95_PERCENT,
        A_ub=-rows, b_ub=np.full(len(likely), -wanted),
        A_eq=kron(eye_array(some), np.ones((1, len(width)))), b_eq=np.ones(some), method="highs",
    )  # fmt: skip
    return found.fun


def scatters():
    """Return squares (k, 2), m^2 and rad^2: none, and every kind at every level."""
    sizes = [np.square(unit) * level**2 for unit in KINDS.values() for level in LEVELS]
    return np.array([[0.0, 0.0], *sizes])


def _steps(number, variance):
    """Return how likely a mean square of ``number`` contrasts lies in each step."""
    middle = chi2.ppf(np.linspace(0.02, 0.98, 12), number) / number
    inner = np.r_[middle, np.geomspace(1.3, 12.0, 12)]
    edges = np.r_[0.0, np.quantile(inner, np.linspace(0.0, 1.0, STEPS)), np.inf]
    return np.diff(chi2.cdf(edges * number / variance, number))


def main():
    print(f"{'':26}{'component':12}{'any width':20}never below the known one")
    print(f"{'':38}" + 2 * "".join(f"{100 * w:.0f} %      " for w in WANTED))
    for case, (arrivals, targets) in CASES.items():
        network = Linear(good_targets()[targets], arrivals)
        for name in ("EXC", "EAC", "ECC"):
            least = [
                narrowest(network, COMPONENTS.index(name), wanted, smallest)
                for smallest in (1.6, HALF_OF_95_PERCENT)
                for wanted in WANTED
            ]
            printed = "".join(f"{value:<10.3f}" for value in least)
            print(f"{case:26}{name:12}{printed}", flush=True)


if __name__ == "__main__":
    main()
