"""Propagates distributions by Monte Carlo, to check the solver's covariance: JCGM 101:2008, 7.9.

A *model* draws trials: ``model(rng, count)`` returns (count, n) output quantities. The trials come
in blocks, and block h always uses the same counter-based random stream, so a result depends on the
seed alone, and not on the number or speed of the workers.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, pi, sqrt
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.dataframes import dataframe
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.results import Result, json_fields
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.method import Measurements

Model = Callable[[np.random.Generator, int], Floats]
Progress = Callable[[int, int], None]
Blocks = Generator[Floats, None, None]

BLOCK: Final = 2000
"""Trials per block: the 100 / (1 - p) that a 95 % interval needs (JCGM 101, 7.9.4 b)."""


@dataclass(frozen=True)
class Propagation:
    """The distribution of n output quantities over the trials, in their own units.

    ``mean``, ``std``, ``low``, ``high`` (n,); low and high bound the probabilistically symmetric
    interval of ``probability``. ``covariance`` is (n, n). ``stable``: all of them are
    stable to ``digits`` significant digits of the standard deviation, or the trials ran out.
    """

    mean: Floats
    std: Floats
    low: Floats
    high: Floats
    covariance: Floats
    probability: float
    digits: int
    trials: int
    stable: bool


def propagate(
    model: Model,
    *,
    seed: int,
    max_trials: int = 100_000,
    digits: int = 2,
    probability: float = 0.95,
    workers: int = 1,
    block: int = BLOCK,
    progress: Progress | None = None,
) -> Propagation:
    """Run trials until the figures are stable to ``digits`` digits, or ``max_trials`` are done.

    Stable (JCGM 101, 7.9.4): over the blocks, twice the standard deviation of the averages of
    mean, std, low and high is below the numerical tolerance of std, for every output. With more
    than one worker the model must be picklable. ``progress(done, max_trials)`` is called after
    every block.
    """
    if not 0.0 < probability < 1.0 or digits < 1 or workers < 1 or block < 2 or seed < 0:
        raise ConfigurationError(
            "Monte Carlo needs 0 < probability < 1, digits and workers >= 1, block >= 2, "
            f"seed >= 0; found {probability}, {digits}, {workers}, {block}, {seed}"
        )
    n_blocks = -(-max_trials // block)
    if n_blocks < 1:
        raise ConfigurationError(f"Monte Carlo needs at least one trial, found {max_trials}")
    values: list[Floats] = []
    figures: list[Floats] = []
    stable = False
    with closing(_blocks(model, seed, block, n_blocks, workers)) as blocks:
        for trials in blocks:
            values.append(trials)
            figures.append(_figures(trials, probability))
            if progress is not None:
                progress(len(values) * block, n_blocks * block)
            stable = _stable(np.array(figures), digits)
            if stable:
                break
    every = np.concatenate(values)
    mean, std, low, high = _figures(every, probability)
    covariance = np.atleast_2d(np.cov(every, rowvar=False))
    return Propagation(mean, std, low, high, covariance, probability, digits, len(every), stable)


def numerical_tolerance(std: Floats, digits: int) -> Floats:
    """Return half a unit in the last of ``digits`` significant digits (JCGM 101, 7.9.2)."""
    safe = np.where(std > 0.0, std, 1.0)
    # Rounding first: 0.0999 with two digits is 0.10, whose last digit is worth more.
    exponent = np.floor(np.log10(safe) - np.log10(1.0 - 0.5 * 10.0**-digits))
    return np.asarray(0.5 * 10.0 ** (exponent - digits + 1), dtype=np.float64)


def compare_with_linear(
    result: Propagation, value: Floats, std: Floats, names: Sequence[str] = ()
) -> list[str]:
    """Return one warning per output whose linear interval the trials contradict.

    ``value`` and ``std`` (n,) are the linear estimates, ``names`` what to call the outputs.

    JCGM 101, 8.1: the ends of value +- k std are compared with those of the trials; they shall
    agree within the numerical tolerance of std, here at least 5 % of std, because an interval that
    is wrong by less does no harm.
    """
    cover = normal_isf(0.5 - 0.5 * result.probability)
    tolerance = np.maximum(numerical_tolerance(std, result.digits), 0.05 * std)
    # A finite number of trials knows the ends of an interval only so well.
    density = exp(-0.5 * cover**2) / sqrt(2.0 * pi)
    share = 0.5 * (1.0 - result.probability)
    tolerance = tolerance + 4.0 * std * np.sqrt(share * (1.0 - share) / result.trials) / density
    low = np.abs(value - cover * std - result.low)
    high = np.abs(value + cover * std - result.high)
    return [
        f"{names[i] if names else f'output {i}'}: the linear standard uncertainty is "
        f"{std[i]:.3g}, the trials say {result.std[i]:.3g} (mean shifted by "
        f"{result.mean[i] - value[i]:.2g}); trust the trials"
        for i in np.flatnonzero((low > tolerance) | (high > tolerance)).tolist()
    ]


def _figures(trials: Floats, probability: float) -> Floats:
    """Mean, std, low and high (4, n) of trials (m, n)."""
    tail = 0.5 * (1.0 - probability)
    low, high = np.quantile(trials, [tail, 1.0 - tail], axis=0)
    return np.stack([trials.mean(axis=0), trials.std(axis=0, ddof=1), low, high])


def _stable(figures: Floats, digits: int) -> bool:
    """JCGM 101, 7.9.4 e) to i) for figures (h, 4, n) of h blocks."""
    h = len(figures)
    if h < 2:
        return False
    spread = figures.std(axis=0, ddof=1) / np.sqrt(h)
    tolerance = numerical_tolerance(figures[:, 1].mean(axis=0), digits)
    return bool(np.all(2.0 * spread <= tolerance))


def _blocks(model: Model, seed: int, block: int, n_blocks: int, workers: int) -> Blocks:
    """Yield the trials of block after block, in order, computed ahead by the workers."""
    if workers == 1:
        for index in range(n_blocks):
            yield model(_stream(seed, index), block)
        return
    # Spawned, not forked: the caller may have threads (a ROS executor, a progress bar).
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _keep_model, (model,)) as pool:
        ahead: deque[Future[Floats]] = deque()
        try:
            for index in range(n_blocks):
                with _left_alone_by_ctrl_c():
                    ahead.append(pool.submit(_run_block, seed, index, block))
                if len(ahead) > workers:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _left_alone_by_ctrl_c() -> Iterator[None]:
    """Start workers that leave Ctrl-C in the terminal to this process, from their first moment."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stream(seed: int, index: int) -> np.random.Generator:
    """Return the random numbers of one block: its index is the high word of the counter."""
    return np.random.Generator(np.random.Philox(key=seed, counter=index << 192))


_worker_model: Model | None = None


def _keep_model(model: Model) -> None:
    global _worker_model
    _worker_model = model


def _run_block(seed: int, index: int, block: int) -> Floats:
    assert _worker_model is not None
    return _worker_model(_stream(seed, index), block)


@dataclass(frozen=True, eq=False)
class PropagatedComponent:
    """One component at all angles (n,), rad or m; ``value`` and ``linear_std`` of the solver."""

    value: Floats
    linear_std: Floats
    mean: Floats
    std: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True, eq=False)
class PropagatedResult:
    """A result and the trials about it; ``seed`` repeats them."""

    result: Result
    spread: Propagation
    seed: int

    @cached_property
    def components(self) -> dict[str, PropagatedComponent]:
        """The figures of solver and trials for each component."""
        names = self.result.components
        columns = (self.spread.mean, self.spread.std, self.spread.low, self.spread.high)
        split = [np.split(column, len(names)) for column in columns]
        return {
            name: PropagatedComponent(
                self.result.deviations[name], self.result.std[name], *(part[k] for part in split)
            )
            for k, name in enumerate(names)
        }

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """The contradictions between trials and solver, in units for people."""
        texts: list[str] = []
        for name, part in self.components.items():
            unit, label = unit_of(name)
            shown = {n: getattr(part, n) / unit for n in ("mean", "std", "low", "high")}
            texts += compare_with_linear(
                replace(self.spread, **shown),
                part.value / unit,
                part.linear_std / unit,
                [f"{name} at {a / DEGREE:.6g} deg ({label})" for a in self.result.angles],
            )
        return tuple(texts)

    def describe(self) -> str:
        """Return the verdict in one line."""
        verdict = "CONTRADICT" if self.warnings else "confirm"
        open_zeros = self.result.zeros.describe()
        within = f"; {open_zeros}: no trial shows it" if open_zeros else ""
        stable = "stable to" if self.spread.stable else "not yet stable to"
        return (
            f"{self.spread.trials} trials {verdict} the solver's uncertainty; {stable} "
            f"{self.spread.digits} digits, seed {self.seed}{within}"
        )

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame: a row for each angle, SI, ``ECC`` with ``ECC_std`` and so on.

        For the columns of a component see :class:`PropagatedComponent`.
        """
        columns = {"angle_rad": self.result.angles}
        for name, part in self.components.items():
            columns[name] = part.value
            columns |= {f"{name}_{n}": v for n, v in vars(part).items() if n != "value"}
        return dataframe(columns)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        facts = ("trials", "stable", "digits", "probability")
        return {
            "schema": 1,
            "method": self.result.method,
            **{name: getattr(self.spread, name) for name in facts},
            "seed": self.seed,
            "angles_rad": self.result.angles.tolist(),
            "components": {name: json_fields(p) for name, p in self.components.items()},
            "warnings": list(self.warnings),
            "open_zeros": self.result.zeros.describe(),
        }


def propagate_measurement(
    measured: Measurements,
    *,
    trials: int,
    digits: int,
    seed: int,
    workers: int,
    progress: Progress | None = None,
) -> PropagatedResult:
    """Solve what was measured and run at most ``trials`` about it, see :func:`propagate`."""
    spread = propagate(
        measured.trials(),
        seed=seed,
        max_trials=trials,
        digits=digits,
        workers=workers,
        block=min(BLOCK, trials),
        progress=progress,
    )
    return PropagatedResult(measured.solve(), spread, seed)
