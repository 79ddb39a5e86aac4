"""Results of one table as inputs of a combination, and the result that is made of them.

What is done about each effect when several results are combined: the weakest of them counts.

An error that one input cannot see keeps its weight in the combination. Nothing is protected that
is not protected in every input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial, reduce
from itertools import combinations
from math import hypot
from typing import Any, Final

import numpy as np

from rotcal_ros.evaluation.common_angles import require_one_table
from rotcal_ros.evaluation.compare import SURE, TOO_ALIKE, agrees_too_well
from rotcal_ros.evaluation.component_groups import (
    GROUPS,
    OPEN,
    ComponentGroup,
    Curves,
    JoinedAngles,
    union_of_angles,
)
from rotcal_ros.foundation.arrays import Floats, std_of
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.curves.interpolation import interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import UNKNOWN, agreed_state
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.protection import (
    ALL_EFFECTS,
    PARTICULAR,
    Effect,
    Protection,
    Treatment,
    unprotected,
)
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import FreeDirection, Result, Verdict, Zeros

ALONE: Final = noted("{0} alone, whose error nothing checks")

METHOD: Final = "combination"
REFERENCE: Final = "reference"
"""The method of a table of values."""
UNCHECKED: Final = phrase("nothing checked its values: none was measured twice")
UNTOLD: Final = (Protection("single readings", "not protected", UNCHECKED),)


@dataclass(frozen=True, eq=False)
class CombinationInput:
    """One input: its curves by component, where it comes from, and how far to trust it.

    ``verdict`` is the one on each part with a zero of its own. ``circumstances`` are None for a
    reference without any; ``measured_on`` is the table in force, see :mod:`..in_force`.
    """

    name: str
    method: str
    curves: Curves
    verdict: Verdict = "ok"
    warnings: tuple[Phrase, ...] = ()
    protections: tuple[Protection, ...] = ()
    circumstances: Circumstances | None = None
    zeros: Zeros = field(default_factory=Zeros)
    raw_data: RawData = field(default_factory=RawData)
    measured_on: str = UNKNOWN

    @property
    def simulated(self) -> bool:
        """Whether a simulation measured it."""
        return self.circumstances is not None and self.circumstances.simulated

    @classmethod
    def of(cls, name: str, source: Result | MeasuredCurve) -> CombinationInput:
        """Return a result, or a reference curve of ECC, as an input.

        Raises DataError for a failed result, and for one that states no uncertainty.
        """
        if isinstance(source, MeasuredCurve):
            known = Circumstances(simulated=True) if source.simulated else None
            measured = cls(name, REFERENCE, {"ECC": source}, circumstances=known)
        else:
            measured = cls(
                name,
                source.method,
                {c: measured_curve(source, c) for c in source.components},
                source.verdict_within,
                source.warnings,
                source.protections,
                source.circumstances,
                source.zeros,
                source.raw_data,
                source.measured_on,
            )
        if measured.verdict == "failed":
            why = f" ({'; '.join(measured.warnings)})" if measured.warnings else ""
            raise DataError(f"{name}: the verdict is failed{why}: leave it out and measure again")
        bare = [c for c, curve in measured.curves.items() if not np.any(curve.covariance)]
        if bare:
            raise DataError(
                f"{name}: {', '.join(bare)} without uncertainty: it cannot be weighted"
            )
        return measured


@dataclass(frozen=True, eq=False)
class Combination:
    """The best estimate, and the groups of components whose inputs were combined for it."""

    result: Result
    groups: tuple[ComponentGroup, ...]


def wanted_groups(inputs: Sequence[CombinationInput]) -> list[list[str]]:
    """Return the components of each group that any of ``inputs`` measured.

    Raises DataError where these are not different measurements of one table.
    """
    names = [measured.name for measured in inputs]
    if not names or len(set(names)) < len(names):
        raise DataError(
            f"inputs {', '.join(names) or 'none'}: give at least one, and each only once: a "
            "second time it would count as an independent measurement"
        )
    circumstances = [(m.name, m.circumstances) for m in inputs if m.circumstances]
    require_one_table({
        "serial number": {name: around.identity.serial for name, around in circumstances},
        "axis": {name: around.axis for name, around in circumstances},
        "compensation in force": {
            m.name: m.measured_on[:12] for m in inputs if m.measured_on != UNKNOWN
        },
    })  # fmt: skip
    for first, second in combinations(inputs, 2):
        for c in first.curves.keys() & second.curves.keys():
            ours, theirs = first.curves[c].deviation, second.curves[c].deviation
            if np.array_equal(ours, theirs) and np.any(ours):  # a bag and its result, a copy
                raise DataError(
                    f"{first.name} and {second.name} hold the same {c} to the last bit: the same "
                    "measurement, which counts only once"
                )
    found = {c for measured in inputs for c in measured.curves}
    wanted: list[list[str]] = [[c for c in group if c in found] for group in GROUPS]
    return [group for group in wanted if group]


def inputs_that_measured(
    group: Sequence[str], inputs: Sequence[CombinationInput]
) -> dict[str, Curves]:
    """Return the curves of those inputs, by name, that measured any component of a ``group``."""
    return {m.name: m.curves for m in inputs if any(c in m.curves for c in group)}


def assemble_result(
    groups: Sequence[ComponentGroup], inputs: Sequence[CombinationInput]
) -> Result:
    """Put the groups together: one set of angles, one verdict."""
    joined = {c: own for group in groups for c, own in group.joined.items()}
    angles = union_of_angles(
        [own.angles for own in joined.values()], any(o.period for o in joined.values())
    )
    deviations, covariance, zeros, left_out = _curves(groups, inputs, angles)
    closed = {c: own for c, own in joined.items() if c not in " ".join(left_out)}
    doubtful = [m for m in inputs if m.verdict != "ok"]
    warnings = [
        phrase("{0} is {1} ({2})", m.name, phrase(m.verdict), join_texts(m.warnings))
        for m in doubtful
    ]
    warnings += [group.describe() for group in groups if not group.consistent]
    warnings += [
        phrase("{0}: {1} (chi2/dof {2:.2f})", g.name, phrase(TOO_ALIKE), g.chi2_of_noise / g.dof)
        for g in groups
        if agrees_too_well(g.chi2_of_noise, g.dof, SURE / len(groups))
    ]
    checked = {n for group in groups if group.dof for names in group.members for n in names}
    unchecked = [m.name for m in inputs if m.method == REFERENCE and m.name not in checked]
    notes = [link.describe() for group in groups for link in group.links] + left_out
    notes += [phrase("{0}: {1}", name, UNCHECKED) for name in unchecked]
    chi2, dof = sum(group.chi2 for group in groups), sum(group.dof for group in groups)
    steps = np.diff(np.eye(len(angles)), axis=0) if "ECC" in deviations else None
    result = Result(
        method=METHOD,
        angles=angles,
        deviations=deviations,
        std={c: std_of(matrix) for c, matrix in covariance.items()},
        covariance=covariance,
        sigma0=float(np.sqrt(chi2 / dof)) if dof else 1.0,
        dof=dof,
        n_observations=sum(len(c.angles) for m in inputs for c in m.curves.values()),
        verdict="suspect" if warnings else "ok",
        warnings=(*warnings, *_read_between(groups, closed, len(angles), {*deviations})),
        adjacent_deviations=None if steps is None else steps @ deviations["ECC"],
        adjacent_std=None if steps is None else std_of(steps @ covariance["ECC"] @ steps.T),
        details=_details(groups, inputs),
        protections=join_protections(
            {
                m.name: UNTOLD * (m.name in unchecked) + _linked(m.protections, m.name, groups)
                for m in inputs
            },
            _largest_shares(groups),
        ),
        circumstances=Circumstances.joined(
            [m.circumstances for m in inputs if m.circumstances is not None]
        ),
        raw_data=reduce(RawData.joined, (m.raw_data for m in inputs)),
        measured_on=agreed_state(m.measured_on for m in inputs),
    ).counted_from("mean", zeros)
    open_zeros = [result.zeros.describe()] if result.zeros.free else []
    return replace(result, warnings=(*result.warnings, *open_zeros, *notes))


def _curves(
    groups: Sequence[ComponentGroup], inputs: Sequence[CombinationInput], angles: Floats
) -> tuple[dict[str, Floats], dict[str, Floats], list[FreeDirection], list[Phrase]]:
    """Return deviations and covariances at ``angles``, what is open, and what is left out."""
    whole = any(not group.open_of(c).shape[1] for group in groups for c in group.joined)
    deviations, covariance = {}, {}
    left_out: dict[Phrase, list[str]] = {}
    free: list[FreeDirection] = []
    for group in groups:
        maps = {
            c: to_all
            for c, own in group.joined.items()
            if (to_all := _to_all(own, angles)) is not None
        }
        names = dict.fromkeys(
            direction.name
            for m in inputs
            for direction in m.zeros.free
            if direction.name and direction.columns.keys() & group.joined.keys()
        )
        words = reduce(partial(phrase, "{0} and {1}"), names) if names else join_texts(())
        for c, to_all in maps.items():
            if whole and group.open_of(c).shape[1]:
                left_out.setdefault(words, []).append(c)
                continue
            deviations[c] = to_all @ group.value[group.columns[c]]
            covariance[c] = to_all @ group.covariance(c) @ to_all.T
        for column in () if whole else group.open.T:
            parts = {c: to_all @ column[group.columns[c]] for c, to_all in maps.items()}
            touched = {c: part for c, part in parts.items() if np.max(np.abs(part)) > OPEN}
            free.append(FreeDirection(words, touched))
    notes = [
        phrase("{0} left out: no input measured the offset between {1}", ", ".join(names), words)
        for words, names in left_out.items()
    ]
    return deviations, covariance, free, notes


def _linked(
    protections: Sequence[Protection], name: str, groups: Sequence[ComponentGroup]
) -> tuple[Protection, ...]:
    """Return the protections of input ``name``; its gauge is estimated if others join it.

    Not protected where a single one does: nothing checks the error of that link.
    """
    own = [link for g in groups for link in g.links if link.input == name]
    if not own:
        return tuple(protections)
    bare = {link.name: link.others[0] for link in own if not link.checked}
    others = sorted({other for link in own for other in link.others})
    joined = Protection(
        "gauge",
        "estimated",
        phrase("the offsets that it leaves open come from {0}", ", ".join(others)),
    )
    if bare:
        links = [
            phrase("the offset between {0} comes from {1}", phrase(what), other)
            for what, other in bare.items()
        ]
        why = phrase(ALONE, join_texts(links, ", "))
        joined = Protection("gauge", "not protected", why)
    return (*(p for p in protections if p.effect != "gauge"), joined)


def _to_all(own: JoinedAngles, angles: Floats) -> Floats | None:
    """Return the matrix from a component's angles to all; None if they leave its arc."""
    if len(own.angles) == len(angles):
        return np.eye(len(angles))
    if own.period == 0.0 and (angles[0] < own.angles[0] or angles[-1] > own.angles[-1]):
        return None
    return interpolation_matrix(own.angles, angles, own.period)


def _read_between(
    groups: Sequence[ComponentGroup],
    joined: Mapping[str, JoinedAngles],
    count: int,
    whole: set[str],
) -> list[Phrase]:
    """Return in words what was not measured at all ``count`` angles; ``whole``: is there now."""
    fewer = []
    for c, own in joined.items():
        if len(own.angles) < count:
            done = (
                phrase("interpolated at the others")
                if c in whole
                else phrase("only on an arc, left out")
            )
            fewer.append(
                phrase(
                    "{0} was measured at {1} of {2} angles: {3}", c, len(own.angles), count, done
                )
            )
    names = {name for group in groups for name in group.interpolated}
    return fewer + [
        phrase(
            "{0} shares fewer than two angles with the others: these are interpolated at its own",
            name,
        )
        for name in sorted(names)
    ]


def _largest_shares(groups: Sequence[ComponentGroup]) -> dict[str, float]:
    """Return by input its largest share of any standard uncertainty of the result, 0 to 1."""
    shares: dict[str, float] = {}
    for group in groups:
        parts = np.sqrt(np.clip(group.shares, 0.0, 1.0)).max(axis=1)
        for names, part in zip(group.members, parts.tolist(), strict=True):
            shares |= {name: max(part, shares.get(name, 0.0)) for name in names}
    return shares


def _details(
    groups: Sequence[ComponentGroup], inputs: Sequence[CombinationInput]
) -> dict[str, Any]:
    """Return the figures for people: where the result comes from and how well it fits."""
    figures = ("chi2", "dof", "p_value", "consistent", "farthest")
    return {
        "inputs": {
            m.name: {"method": m.method, "verdict": m.verdict, "components": ", ".join(m.curves)}
            for m in inputs
        },
        "links": [asdict(link) for group in groups for link in group.links],
        "weights": {group.name: group.weights for group in groups},
        "consistency": {
            group.name: {name: getattr(group, name) for name in figures} for group in groups
        },
        "enlargement": {
            group.name: {
                "kind": group.enlargement,
                "factor": group.factor,
                "common_std": group.common_std,
            }
            for group in groups
            if not group.consistent
        },
    }


WEAKEST_FIRST: Final[tuple[Treatment, ...]] = (
    "not protected",
    "tested",
    "bounded",
    "estimated",
    "harmless",
)
LASTING: Final[frozenset[Effect]] = frozenset(
    ("error motion", "refraction", "scale", "tilt", "gauge", "tangential motion")
)
"""Effects of instrument, table or room: every campaign may have the same, with one sign."""


def join_protections(
    inputs: Mapping[str, Sequence[Protection]], shares: Mapping[str, float]
) -> tuple[Protection, ...]:
    """Return the protections of a combination; empty when no input states any.

    ``inputs`` are those of each input by name, ``shares`` (0 to 1) its largest share of any
    standard uncertainty of the combination. An input that states nothing counts as not protected.
    An error that stays unseen in an input (in its standard uncertainties) enters the combination
    with that share; lasting effects add up, those of one campaign add as squares.
    """
    if not any(inputs.values()):
        return ()
    named = {p.effect for protections in inputs.values() for p in protections}
    return tuple(
        _joined(effect, inputs, shares)
        for effect in ALL_EFFECTS
        if effect in named or effect not in PARTICULAR
    )


def weaker_protection(first: Protection, second: Protection) -> Protection:
    """Return that of two protections against an effect that leaves more unseen."""

    def left(p: Protection) -> tuple[bool, int, float]:
        return bool(unprotected([p])), -WEAKEST_FIRST.index(p.treatment), p.error or 0.0

    return max(first, second, key=left)


def _joined(
    effect: Effect, inputs: Mapping[str, Sequence[Protection]], shares: Mapping[str, float]
) -> Protection:
    silent = Protection(effect, "not protected", phrase("not stated"))
    stated = {
        name: next((p for p in protections if p.effect == effect), silent)
        for name, protections in inputs.items()
        # A particular effect concerns those that mention it.
        if effect not in PARTICULAR or any(p.effect == effect for p in protections)
    }
    rank = WEAKEST_FIRST.index
    weakest = min((p.treatment for p in stated.values()), key=rank)
    named = {name: p for name, p in stated.items() if p.treatment == weakest}
    errors = [shares[name] * p.error for name, p in stated.items() if p.error is not None]
    error = sum(errors) if effect in LASTING else hypot(*errors)
    why = join_texts([phrase("{0}: {1}", name, p.why) for name, p in sorted(named.items())])
    return Protection(effect, weakest, why, error if errors else None)
