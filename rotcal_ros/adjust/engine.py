"""From a model to a result that says what could be wrong with it: the whole of the engine.

:func:`adjust` takes a :class:`~.model.Model` and goes through these stages.

1. *Start.* Least absolute deviations, then concentration on the better part of every group, lead
   to a place that gross errors do not bend; what misses it beyond all noise waits outside, unless
   something explains it together.
2. *Noise.* Components are tested, and estimated where the statement is contradicted
   (:mod:`.noise`).
3. *Causes.* Groups, effects and single observations are asked what explains the residuals, until
   nothing significant is left (:mod:`.causes`).
4. *Statement.* Covariance, doubts in words, verdict, and what each effect may do unseen.

:func:`predicted` gives the same of a plan without data.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import gathering
from rotcal_ros.adjust.causes import diagnose_causes
from rotcal_ros.adjust.closures import ClosureTest
from rotcal_ros.adjust.diagnosis import Diagnosis, Limits
from rotcal_ros.adjust.distributions import chi2_sf, noise_growth, noncentrality, normal_sf, t_isf
from rotcal_ros.adjust.effects import (
    COVERED,
    LargestUndetected,
    ObservableEffect,
    ObservableFamily,
    effect_test,
    expected_weights,
    family_test,
    largest_undetected,
    largest_undetected_of_family,
)
from rotcal_ros.adjust.fit import Fit, fit_model, require_determined
from rotcal_ros.adjust.gathering import SUSPECTED
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.look import LARGEST_GROUP
from rotcal_ros.adjust.model import Disturbing, Model, Steps
from rotcal_ros.adjust.noise import PRIOR
from rotcal_ros.adjust.observable import observe_effect
from rotcal_ros.adjust.reliability import largest_undetectable_shift
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.compact import (
    FULL,
    CompactCovariance,
    Covariances,
    Spread,
    variances_of,
    written,
)
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.protection import POWER, TOLERABLE, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence, RawData
from rotcal_ros.foundation.results import Rejection, Residuals, Result, Verdict

NO_OTHER_CHECKS: Final = noted(
    "{0} of {1} {2} are not checked by others: an error in them goes undetected"
)
NOT_ASKED: Final = noted(
    "groups of more than {0} {1} are only tested as a whole, not for subsets that are off together"
)
MANY_LOST: Final = noted("{0} of {1} {2} were rejected; more than {3:g} % is suspicious")
UNCONTRADICTED: Final = noted("no redundant {0}: nothing checks the result")
RIVALLED: Final = noted(
    "it looks as if {0}, but others explain the readings nearly as well (likelihood in "
    "brackets): {1}; the uncertainty covers them all"
)
TAKEN_OFF: Final = noted(
    "it looks as if {0}: this was corrected, and its uncertainty is included; find the "
    "cause and measure again"
)
ENLARGED: Final = noted(
    "the residuals are {0:.2g} times what their standard deviations allow (chi-squared test): "
    "the uncertainty is enlarged by that factor"
)
SCATTERS: Final = noted(
    "the scatter of {0} is {1:.2g} times the stated value: the estimate is used; state "
    "it, or look for drift"
)

COVARIANCE_LIMIT: Final = 720
"""Most deviations of a component whose covariance is put into the result (4 MB)."""
SOLVED: Final = 32
"""Trials that are solved at once."""
MOST_AT_ONCE: Final = 20_000_000
"""Most numbers in what each observation does to the outputs that are asked for (160 MB)."""
LARGEST: Final = 1000.0
"""Errors of several observations, in their stated noise, that nobody would overlook."""
FAILED_SHARE: Final = 0.2
"""Share of rejected observations from which the rest proves nothing."""
FAILED_FACTOR: Final = 10.0
"""Times the stated noise from which the model does not describe the observations."""
SURE: Final = 0.01
"""Standard deviation of the logarithm of a noise up to which Student's t is the normal one."""
UNCHECKED: Final = 0.99
"""Share of its prior from which on the factor of a component is no estimate."""
MOST_SIZES: Final = 6
"""Sizes of an effect that are told one by one."""
ROUNDED: Final = 1e-6
"""Uncertainty of a size, per largest, below which it is the rounding of one that is open."""
LIMITS: Final = Limits()


BY_SO_MUCH: Final = noted("{0}, by {1} {2} (k = 2, p = {3:.2g})")
AT_MOST: Final = noted("{0}, by up to {1} {2} (k = 2, p = {3:.2g})")


def _with_bands(pairs: Iterable[tuple[float, float]]) -> Phrase:
    return join_texts([phrase("{0:.3g} ± {1:.2g}", size, u) for size, u in pairs], ", ")


class FoundEffect(NamedTuple):
    """An effect that was found: ``sizes`` (k,) of its columns, or of one of a family, and ``std``.

    ``probability``: how probably chance explains so much, when it was found.
    """

    effect: Disturbing
    what: Phrase
    sizes: Floats
    std: Floats
    probability: float

    def describe(self) -> Phrase:
        """Return what happened, by how much as far as the observations show it."""
        unit, seen = self.effect.unit, self.std > ROUNDED * self.std.max(initial=0.0)
        sizes, expanded = self.sizes[seen] / unit.si, 2.0 * self.std[seen] / unit.si
        pairs, text = list(zip(sizes.tolist(), expanded.tolist(), strict=True)), BY_SO_MUCH
        if len(pairs) > MOST_SIZES:
            pairs, text = [max(pairs, key=lambda pair: abs(pair[0]))], AT_MOST
        return phrase(text, self.what, _with_bands(pairs), unit.name, self.probability)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A solved model: the ``diagnosis`` of its observations, and the solution that follows."""

    diagnosis: Diagnosis
    fit: Fit

    @property
    def model(self) -> Model:
        """What was solved."""
        return self.fit.model

    @property
    def why(self) -> dict[int, Phrase]:
        """By row, why an observation was left out."""
        return self.diagnosis.why

    @property
    def value(self) -> Floats:
        """The outputs (o,)."""
        return self.fit.value[: len(self.model.outputs)]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (o, o) of the outputs, with all that is probable but not proved.

        Where the noise was estimated from few residuals, 1.96 of its standard uncertainties hold
        95 % as those of Student's t do.
        """
        return written(self.spread)

    @cached_property
    def spread(self) -> Spread:
        """The same in the form in which it is kept."""
        return self._spread_of(slice(len(self.model.outputs)))

    def _spread_of(self, part: slice) -> Spread:
        """Return the covariance of a ``part`` of the outputs, compact where these are many."""
        few, gathers = (self.scale * self._student)[part], self.diagnosis.gathering.covariance()
        compact = self.fit.compact(part) if len(few) > FULL else None
        if compact is not None and not isinstance(gathers, np.ndarray):
            compact = compact.scaled(few)
            for changes in self._probable:
                compact = compact.plus(CompactCovariance.shared(changes[part]))
            if gathers is None:
                return compact
            return compact.plus(gathers.part(part)).condensed()
        total = self.fit.covariance(part)
        total *= few[:, None]
        total *= few
        for changes in self._probable:
            total += changes[part] @ changes[part].T
        if gathers is None:
            return total
        return np.add(total, written(gathers)[part, part], out=total)

    @cached_property
    def _probable(self) -> list[Floats]:
        """What is probable but not proved does to the outputs, (o + a, k) per unit normal each."""
        found = list(self.diagnosis.possible())
        for effect, size, probability in self.model.expected:
            seen = observe_effect(self.fit, effect)
            assert isinstance(seen, ObservableFamily)
            weight = expected_weights(seen, size, probability)
            stride = -(-len(weight) * len(self.fit.value) // MOST_AT_ONCE)
            root = np.sqrt(stride * weight[::stride])
            found.append((root[:, None] * seen.moved[::stride]).T)
        return found

    @cached_property
    def further(self) -> Mapping[str, tuple[Floats, Floats]]:
        """What else the model determines, by name: values (a,) and standard uncertainties (a,)."""
        sizes = [len(rows) for rows in self.model.further.values()]
        ends = np.cumsum([len(self.model.outputs), *sizes]).tolist()
        return {
            name: (self.fit.value[a:b], self._every_std[a:b])
            for name, a, b in zip(self.model.further, ends[:-1], ends[1:], strict=True)
        }

    @cached_property
    def _student(self) -> Floats:
        """Quantile of what is predicted over that of the normal distribution, by output (o + a,).

        That of Student's t, and for scatter of a size that is hardly known.
        Degrees of freedom after Satterthwaite, from how well the factors of the noise are known. A
        component that nothing checks was not estimated: its statement stands.
        """
        known = self._log_std
        if known.max(initial=0.0) < SURE:
            return self.fit.enlargement
        variance = self.fit.variance_by_component
        spread = 2.0 * (variance**2 * known**2).sum(axis=1)
        safe = np.maximum(spread, np.finfo(np.float64).tiny)
        dof = np.where(spread > 0.0, np.maximum(variance.sum(axis=1) ** 2 / safe, 1.0), np.inf)
        tail = normal_sf(COVERED)
        few = np.array([t_isf(tail, d) / COVERED if np.isfinite(d) else 1.0 for d in dof])
        return np.asarray(few * self.fit.enlargement)

    @cached_property
    def _log_std(self) -> Floats:
        """Standard deviations (c,) of the logarithm of each estimated noise; zero: it is stated.

        Or nothing checks it, or it is absent.
        """
        estimated = self.diagnosis.noise.estimated
        if estimated is None:
            return np.zeros(len(self.model.components))
        return np.where(estimated.log_std < UNCHECKED * PRIOR, estimated.log_std, 0.0)

    @cached_property
    def found_effects(self) -> tuple[FoundEffect, ...]:
        """The effects that became unknowns, with their sizes in the solution."""
        first, found = self.model.size[1], []
        for e in self.diagnosis.nuisance:
            assert e.effect is not None
            assert e.mixing is not None
            own = slice(first, first + e.columns.shape[1])
            gain = e.mixing @ self.fit.gain(own)
            std = self.scale * np.linalg.norm(gain, axis=1)
            sizes = e.mixing @ self.fit.x[own]
            found.append(FoundEffect(e.effect, e.what, sizes, std, e.probability))
            first = own.stop
        return tuple(found)

    @property
    def std(self) -> Floats:
        """Standard uncertainties (o,) of the outputs."""
        return self._every_std[: len(self.model.outputs)]

    @cached_property
    def _every_std(self) -> Floats:
        variance = (self.scale * self._student) ** 2 * self.fit.variance
        for changes in self._probable:
            variance = variance + (changes**2).sum(axis=1)
        gathers = self.diagnosis.gathering.covariance()
        return np.sqrt(variance if gathers is None else variance + variances_of(gathers))

    @property
    def counting_std(self) -> Floats:
        """Standard uncertainties (o + a,) of all outputs; infinite: it counts in no test."""
        return self.fit.counting(self._every_std)

    @property
    def freedom(self) -> float:
        """Degrees of freedom from which the noise was estimated; infinite: it is that stated."""
        return float(self.fit.dof) if self.diagnosis.noise.estimated else np.inf

    @property
    def scale(self) -> float:
        """Factor on all standard uncertainties for noise that its components do not explain."""
        fit, significance = self.fit, self.diagnosis.limits.significance
        if not fit.dof or fit.chi2 <= fit.dof or chi2_sf(fit.chi2, fit.dof) >= significance:
            return 1.0
        return float(np.sqrt(fit.chi2 / fit.dof))

    @property
    def sigma0(self) -> float:
        """Scatter of the residuals over what is stated; 1 where nothing is checked."""
        fit = self.fit
        stated = np.where(fit.used, fit.residual / self.model.std, 0.0)
        return float(np.sqrt(stated @ stated / fit.dof)) if fit.dof else 1.0

    @cached_property
    def seen(self) -> list[tuple[Disturbing, ObservableEffect | ObservableFamily]]:
        """What the solution makes of each declared effect, and closures beside it."""
        found = []
        for effect in self.model.effects:
            seen = observe_effect(self.fit, effect)
            for closed in self.closed:
                seen = closed.beside(effect, seen)
            found.append((effect, seen))
        return found

    @cached_property
    def closed(self) -> tuple[ClosureTest, ...]:
        """How the outputs keep what they are known to keep."""
        each = self.model.closures
        return tuple(ClosureTest(self.fit, known, self.scale, self._log_std) for known in each)

    @cached_property
    def doubts(self) -> tuple[Phrase, ...]:
        """A sentence about everything that is odd; any makes the result suspect."""
        return tuple(_doubts(self))

    @property
    def verdict(self) -> Verdict:
        """Whether the model describes the observations."""
        share = self.diagnosis.lost / max(self.model.rejectable_elements, 1)
        larger = self.scale * self.diagnosis.noise.factors.max(initial=1.0)
        if share > FAILED_SHARE or (larger > FAILED_FACTOR and not self.model.unstated):
            return "failed"
        return "suspect" if self.doubts else "ok"

    @cached_property
    def trials(self) -> Trials:
        """Measurements with the noise that was used, and with what is probable but not proved."""
        few, size = self.scale * self._student, len(self.value)
        many = size * len(self.fit.std) > MOST_AT_ONCE and not self.model.correlated
        causes = [np.zeros((len(few), 0)) if many else few[:, None] * self.fit.response]
        causes += self._probable
        gathers = self.diagnosis.gathering.covariance()
        if gathers is not None:
            values, vectors = np.linalg.eigh(written(gathers))
            # of all roots the one that no sign of a vector, and no order of equals, changes
            causes.append((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
        beside = np.concatenate(causes, axis=1)[:size]
        if many:
            return TrialsOfNoise(self.value, beside, self.fit, few[:size])
        return Trials(self.value, beside)

    def protections(self) -> tuple[Protection, ...]:
        """Return what is done about each declared effect, the noise, and what gathers."""
        return self._protections

    @cached_property
    def _protections(self) -> tuple[Protection, ...]:
        return tuple(_protections(self))

    def result(
        self,
        method: str,
        angles: Floats,
        components: Mapping[str, slice],
        places: tuple[Ints, Ints],
        *,
        counts_from: str = "first angle",
        coordinates: int = 1,
        doubts: Sequence[Phrase] = (),
        protections: Sequence[Protection] = (),
        details: Mapping[str, Any] | None = None,
        joint: bool = False,
        further: bool = True,
    ) -> Result:
        """Return the result that all methods share, the table at ``angles`` (m,), rad.

        ``components`` says which outputs are the deviations of which component. ``places``: table
        position (k,) and target (k,) of the first k observations, which a table measured; others
        are known beforehand. An observation of three ``coordinates`` is three rows of the model,
        one after the other: it was rejected if one of them was. What the method itself doubts,
        protects against and says joins what was found here; its word on an effect takes the place
        of ours. Covariances of more than COVARIANCE_LIMIT deviations are left out, unless
        what is done next takes them (``joint``). ``further`` as of :meth:`details`.
        """
        kept = joint or max(len(self.value[p]) for p in components.values()) <= COVARIANCE_LIMIT
        every = {p.effect: p for p in (*self.protections(), *protections)}
        suspect = self.verdict == "ok" and bool(doubts)
        return Result(
            method=method,
            angles=angles,
            deviations={name: self.value[part] for name, part in components.items()},
            std={name: self.std[part] for name, part in components.items()},
            covariance=Covariances(
                {
                    name: self.spread if part == slice(None) else self._spread_of(part)
                    for name, part in components.items()
                }
                if kept
                else {}
            ),
            sigma0=self.sigma0,
            dof=self.fit.dof,
            n_observations=len(places[0]),
            rejected=self._rejected_of(coordinates),
            verdict="suspect" if suspect else self.verdict,
            warnings=(*doubts, *self.doubts),
            protections=ordered(every.values()),
            residuals=self._residuals(places, coordinates),
            raw_data=RawData(influence=self.influence(components, len(places[0]), coordinates)),
            details={**self.details(further=further), **(details or {})},
        ).counted_from(counts_from)

    def _rejected_of(self, coordinates: int) -> tuple[Rejection, ...]:
        """Return the observations of so many rows each that were left out, by the first reason."""
        why: dict[int, Phrase] = {}
        for row, reason in sorted(self.why.items()):
            why.setdefault(row // coordinates, reason)
        return tuple(Rejection(*each) for each in why.items())

    def _residuals(self, places: tuple[Ints, Ints], coordinates: int) -> Residuals:
        """Return the residuals of the measured observations, those of a point by their length."""
        fit, count = self.fit, len(places[0])

        def rows(values: Floats) -> Floats:
            return values[: count * coordinates].reshape(count, coordinates)

        mixed = self.model.mixed
        read = fit.residual if mixed is None else mixed @ fit.residual
        residual, test = rows(read), rows(fit.test_value)
        worst = np.abs(test).argmax(axis=1)
        return Residuals(
            *places,
            residual[:, 0] if coordinates == 1 else np.linalg.norm(residual, axis=1),
            rows(fit.redundancy).mean(axis=1),
            test[np.arange(count), worst],
            np.asarray(rows(fit.used.astype(np.float64)).all(axis=1), dtype=np.bool_),
            np.sqrt((rows(fit.std) ** 2).mean(axis=1)),
            coordinates,
            "rad" if self.model.unit.angular else "m",
        )

    def influence(
        self, components: Mapping[str, slice], measured: int, coordinates: int
    ) -> Influence | None:
        """Return what standard errors of what is used do to the deviations; None of too many."""
        count = measured * coordinates
        if sum(len(self.value[p]) for p in components.values()) * count > MOST_INFLUENCES:
            return None
        used = self.fit.used[:count].reshape(measured, coordinates)
        seen, known = np.flatnonzero(used.any(axis=1)), np.arange(count, len(self.fit.used))
        rows = (seen[:, None] * coordinates + np.arange(coordinates)).ravel()
        influence = self.scale * self.fit.response_of(np.append(rows, known))
        causes = tuple(self.model.name_of_row(row) for row in known.tolist())
        parts = {n: influence[part] for n, part in components.items()}
        return Influence(seen, coordinates, parts, causes)

    def details(self, *, further: bool = True) -> dict[str, Any]:
        """Return what was found for the details of a result, SI.

        ``further``: with the further outputs, which a method may have of which it makes its own.
        """
        scattering = {
            each.what: {
                "size": sizes.median_size,
                "contrasts": sizes.contrasts,
                "none": float(sizes.weight[sizes.size == 0.0].sum()),
            }
            for each, sizes in self.fit.sizes.items()
        }
        others = {name: {"value": x, "std": u} for name, (x, u) in self.further.items()}
        closed = [
            {"what": c.relation.what, "error": c.error, "std": c.std, "p_value": c.probability}
            for c in self.closed
        ]
        return {
            **({"scattering": scattering} if scattering else {}),
            **({"closed": closed} if closed else {}),
            "chi_square": {
                "value": self.fit.chi2,
                "dof": self.fit.dof,
                "p_value": chi2_sf(self.fit.chi2, self.fit.dof) if self.fit.dof else None,
            },
            "noise": dict(
                zip(self.model.components, self.diagnosis.noise.factors.tolist(), strict=True)
            ),
            "effects_found": [
                {"effect": e.effect.effect, "what": e.what, "size": e.sizes, "std": e.std}
                for e in self.found_effects
            ],
            "gathering": gathering.gathering_details(self.diagnosis.gathering, "observations"),
            **({"also": others} if further else {}),
        }


@dataclass(frozen=True, eq=False)
class Trials:
    """Draws outputs about their ``value`` (o,), by what each of k independent causes does to them.

    ``causes`` (o, k): per standard deviation.
    """

    value: Floats
    causes: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return outputs (count, o)."""
        drawn = rng.standard_normal((count, self.causes.shape[1]))
        return np.asarray(self.value + drawn @ self.causes.T)


@dataclass(frozen=True, eq=False)
class TrialsOfNoise(Trials):
    """The same of very many observations, whose noise is drawn and solved: ``few`` (o,) times."""

    fit: Fit
    few: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return outputs (count, o)."""
        found, outputs = super().__call__(rng, count), self.fit.model.counting_outputs
        for begin in range(0, count, SOLVED):
            part = found[begin : begin + SOLVED]
            white = rng.standard_normal((len(self.fit.std), len(part)))
            part += outputs.times(self.fit.kernel.solve(white)).T * self.few
        return found


@dataclass(frozen=True, eq=False)
class PlanPrediction:
    """What a plan would give: ``std`` (o,), ``redundancy`` (n,), by effect what stays unseen."""

    std: Floats
    redundancy: Floats
    undetected: dict[Effect, LargestUndetected]


def predicted(model: Model, limits: Limits = LIMITS) -> PlanPrediction:
    """Return what ``model`` would give; its observations do not matter.

    An effect that depends on what is read (a scale) is left out where the start values read
    nothing. Raises ObservabilityError where they leave a direction open.
    """
    require_determined(model)
    computed, _ = model.equations(model.first)
    # nothing is read yet that would tell ways to move apart
    correlated = [each.planned() for each in model.correlated]  # data would say what is likely
    exact = replace(model, observed=computed, correlated=correlated)
    fit = fit_model(exact, np.ones(len(computed), dtype=np.bool_), model.std, model.first)
    every_std = fit.noise_std
    std, counting = every_std[: len(model.outputs)], fit.counting(every_std)
    each = limits.of_each_effect(model)
    every = {
        e.effect: _undetected(e, observe_effect(fit, e), counting, each)
        for e in model.effects
        if isinstance(e.columns, Steps) or e.whole(computed).any()
    }
    return PlanPrediction(std, fit.redundancy, every)


def adjust(model: Model, limits: Limits = LIMITS) -> Adjusted:
    """Solve ``model`` and say what is wrong with it; see the module's docstring.

    Raises ObservabilityError where the observations leave more open than the free directions,
    DataError where they contradict each other so much that nothing settles.
    """
    require_determined(model)
    diagnosis = diagnose_causes(model, limits)
    return Adjusted(diagnosis, diagnosis.fit)


def _doubts(found: Adjusted) -> Iterator[Phrase]:
    model, limits = found.model, found.diagnosis.limits
    for k in np.flatnonzero(_larger(found)).tolist():
        yield phrase(SCATTERS, phrase(model.components[k]), found.diagnosis.noise.factors[k])
    for each, sizes in found.fit.sizes.items():
        if each.stated is not None and sizes.probability < each.significance:
            yield phrase(SCATTERS, phrase(each.what), sizes.median_size / each.stated)
    if found.scale > 1.0:
        yield phrase(ENLARGED, found.scale)
    for e in found.found_effects:
        yield phrase(TAKEN_OFF, e.describe())
    for best, rivals in found.diagnosis.unresolved_contests:
        odds = [np.exp(max(best.support - e.support, 0.0)) for e in rivals]
        others = [
            phrase("that {0} (1 : {1:.2g})", e.what, o) for e, o in zip(rivals, odds, strict=True)
        ]
        yield phrase(RIVALLED, best.what, join_texts(others))
    yield from gathering.gathering_doubts(
        found.diagnosis.gathering, limits.gathered_share, limits.significance, model.words,
        model.unit,
    )  # fmt: skip
    yield from _open(found)
    if not found.fit.dof:
        yield phrase(UNCONTRADICTED, phrase(model.words.elements))
    lost, all_of_them = found.diagnosis.lost, model.rejectable_elements
    if lost > limits.rejected_share * all_of_them:
        yield phrase(
            MANY_LOST, lost, all_of_them, phrase(model.words.elements), 100 * limits.rejected_share
        )


def _open(found: Adjusted) -> Iterator[Phrase]:
    """Yield what outputs do not keep, and effects that it shows where residuals alone do not."""
    limits = found.diagnosis.limits
    for closed in found.closed:
        unit = closed.relation.unit or found.model.unit
        if closed.probability < limits.significance / len(found.closed):
            sizes = (closed.error / unit.si).tolist(), (2.0 * closed.std / unit.si).tolist()
            each, what = _with_bands(zip(*sizes, strict=True)), phrase(closed.relation.what)
            differs = phrase(BY_SO_MUCH, what, each, unit.name, closed.probability)
            yield phrase("{0}: something moved or drifted in between", differs)
    rest = None
    if np.isfinite(found.freedom):  # what does not close is among what effects explain
        parts = [(found.fit.chi2, found.fit.dof), *(closed.squares for closed in found.closed)]
        rest = sum(squares for squares, _ in parts), float(sum(rank for _, rank in parts))
    named = {e.effect.effect for e in found.found_effects}
    for effect, seen in found.seen if found.closed else ():
        test = (
            family_test(seen, rest)
            if isinstance(seen, ObservableFamily)
            else effect_test(seen, rest)
        )
        if test.probability < limits.of_each_effect(found.model) and effect.effect not in named:
            yield phrase(
                "it looks as if {0} (p = {1:.2g}), by residuals and by what does not close: it "
                "was not corrected for; find the cause, and measure again", phrase(effect.what),
                test.probability
            )  # fmt: skip


def _larger(found: Adjusted) -> Bools:
    """Return which components of the noise are larger than stated."""
    estimated = found.diagnosis.noise.estimated
    if estimated is None or found.model.unstated:
        return np.zeros(len(found.model.components), dtype=np.bool_)
    beyond = estimated.contradicted(found.diagnosis.limits.significance)
    return np.asarray(beyond & (estimated.factors > 1.0), dtype=np.bool_)


def _protections(found: Adjusted) -> Iterator[Protection]:
    each = found.diagnosis.limits.of_each_effect(found.model)
    taken = [e.effect for e in found.diagnosis.nuisance if e.effect is not None]
    worst: dict[Effect, tuple[LargestUndetected, Disturbing]] = {}
    for effect, seen in found.seen:
        if effect in taken and effect.family:
            continue
        hides = _undetected(effect, seen, found.counting_std, each, found.freedom)
        if effect in taken and hides.treatment != "not protected":
            continue  # all of it was taken off
        if effect.effect not in worst or hides.error > worst[effect.effect][0].error:
            worst[effect.effect] = hides, effect
    for name, effect in {effect.effect: effect for effect in taken}.items():
        if name not in worst or worst[name][0].treatment == "harmless":
            worst.pop(name, None)
            yield Protection(
                name,
                "estimated",
                phrase("found and corrected: {0}", phrase(effect.what)),
            )
    for name, (hides, effect) in worst.items():
        silent = phrase("leaves no residual")
        if not hides.hidden:
            silent = phrase("is found only beyond {0}", effect.unit.shown(effect.largest))
        why = {
            "harmless": phrase("moves the result by less than a tenth of its uncertainty"),
            "not protected": silent,
            "tested": found.model.words.contradicts,
        }[hides.treatment]
        error = None if hides.treatment == "harmless" else hides.error
        yield Protection(
            name, hides.treatment, phrase("that {0} {1}", phrase(effect.what), why), error
        )
    yield _against_noise(found)
    yield from _against_single(found)
    yield from _against_gathering(found)


def _undetected(
    effect: Disturbing,
    seen: ObservableEffect | ObservableFamily,
    std: Floats,
    significance: float,
    dof: float = np.inf,
) -> LargestUndetected:
    size, limits = effect.largest, {"significance": significance, "power": POWER, "dof": dof}
    if isinstance(seen, ObservableFamily):
        return largest_undetected_of_family(seen, std, size, usual=effect.usual, **limits)
    return largest_undetected(seen, std, size, **limits)


def _against_noise(found: Adjusted) -> Protection:
    dof = found.fit.dof
    if not dof:
        return Protection("axis noise", "not protected", phrase("nothing is measured twice"))
    growth = noise_growth(found.diagnosis.limits.significance, POWER, dof)
    why = phrase(
        "{0} residuals test the stated noise, which is estimated where it does not hold", dof
    )
    return Protection("axis noise", "tested", why, float(np.sqrt(max(growth - 1.0, 0.0))))


def _against_single(found: Adjusted) -> Iterator[Protection]:
    """Yield what is done about one reading that is off, where there are not too many of them.

    The error is that of any of them, as probable, by the largest size that is not left out.
    """
    model, fit, limits = found.model, found.fit, found.diagnosis.limits
    std, words = found.counting_std[: len(found.value)], model.words
    first = model.elements[:, 0]
    each = np.flatnonzero((fit.used & model.rejectable)[first])
    if not len(each) or len(std) * len(each) > MOST_AT_ONCE:
        return
    sizes, counts = (model.elements[each] >= 0).sum(axis=1), std > 0.0
    squares, significance = np.zeros(len(std)), limits.of_each_observation(model)
    for size in np.unique(sizes).tolist():
        alike = model.elements[each[sizes == size], :size]
        needed = noncentrality(significance, POWER, size)
        cofactor, kind = fit.cofactors(alike)
        values, ways = np.linalg.eigh(cofactor)
        seen = np.maximum(values, needed / LARGEST**2)
        weight = ((ways * (needed / seen / len(each))[:, None]) @ ways.swapaxes(1, 2))[kind]
        first, second = np.repeat(alike, size, axis=1), np.tile(alike, (1, size))
        found_of = fit.output_products(first.ravel(), second.ravel(), weight.reshape(1, -1))
        squares += found_of[: len(std), 0]
    squares = squares[counts] / std[counts] ** 2
    error = float(np.sqrt(squares.max(initial=0.0)))
    if error <= TOLERABLE:
        yield Protection(
            "single readings",
            "tested",
            phrase("{0} check each other", phrase(words.elements)),
            error,
        )
        return
    why = phrase(
        "{0} barely check each other: an error in one of them goes undetected",
        phrase(words.elements),
    )
    if weak := _unchecked(fit):
        why = phrase(NO_OTHER_CHECKS, weak, len(each), phrase(words.elements))
    yield Protection("single readings", "not protected", why, error)


def _unchecked(fit: Fit) -> int:
    """Return how many of the elements that may be left out hold a row that no other checks."""
    open_ = fit.used & fit.model.rejectable & (fit.redundancy <= CHECKED)
    return len(np.unique(fit.model.of_element[open_]))


def _against_gathering(found: Adjusted) -> Iterator[Protection]:
    judgement, fit = found.diagnosis.gathering.judgement, found.fit
    if open_ := _unchecked(fit):
        every = fit.used[found.model.elements[:, 0]].sum()
        why = phrase(NO_OTHER_CHECKS, open_, every, phrase(found.model.words.elements))
        yield Protection("one place", "not protected", why)
        return
    if judgement is None:
        return
    asked = {group.name for group in judgement.groups}
    gathers = {g.kind for g in found.model.groupings if g.gathers}
    counts = (row for row in found.diagnosis.gathering.counts if row.kind in gathers)
    most = LARGEST_GROUP // found.model.elements.shape[1]
    if any(row.whole > most and row.name not in asked for row in counts):
        why = phrase(NOT_ASKED, most, phrase(found.model.words.elements))
        yield Protection("one place", "not protected", why)
        return
    words, unit = found.model.words, found.model.unit
    worst = largest_undetectable_shift(
        judgement, found.counting_std, SUSPECTED, POWER, LARGEST * float(found.model.std.max())
    )
    if worst is None:
        return
    what = phrase(
        "several {0} that are off together ({1})", phrase(words.elements), phrase(words.cause)
    )
    if not worst.seen:
        yield Protection("one place", "not protected", phrase("{0} leave no residual", what))
        return
    why = phrase(
        "{0} are looked for; {1} of {2} by {3} are found, the worst case", what, worst.count,
        worst.name, unit.shown(worst.size)
    )  # fmt: skip
    yield Protection("one place", "tested", why, worst.error)
