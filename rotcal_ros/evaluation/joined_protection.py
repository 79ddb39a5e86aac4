"""What is done about each effect when several results are combined: the weakest of them counts.

An error that one input cannot see keeps its weight in the combination. Nothing is protected that
is not protected in every input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Final

from rotcal_ros.protection import ALL_EFFECTS, PARTICULAR, Effect, Protection, Treatment

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
"""Effects of instrument, table or room: every campaign may have the same one, with one sign."""


def join_protections(
    inputs: Mapping[str, Sequence[Protection]], shares: Mapping[str, float]
) -> tuple[Protection, ...]:
    """Return the protections of a combination; empty when no input states any.

    ``inputs`` are those of each input by name, ``shares`` (0 to 1) its largest part of any
    standard uncertainty of the combination. An input that states nothing counts as not
    protected. An error that stays unseen in an input, in its own standard uncertainties, is
    worth the share of it in those of the combination; lasting effects add up, those of one
    campaign add as squares.
    """
    if not any(inputs.values()):
        return ()
    named = {p.effect for protections in inputs.values() for p in protections}
    return tuple(
        _joined(effect, _concerned(effect, inputs), shares)
        for effect in ALL_EFFECTS
        if effect in named or effect not in PARTICULAR
    )


def _concerned(
    effect: Effect, inputs: Mapping[str, Sequence[Protection]]
) -> Mapping[str, Sequence[Protection]]:
    """Return the inputs that may have ``effect``: of a particular one, those that speak of it."""
    if effect not in PARTICULAR:
        return inputs
    return {n: ps for n, ps in inputs.items() if any(p.effect == effect for p in ps)}


def _joined(
    effect: Effect, inputs: Mapping[str, Sequence[Protection]], shares: Mapping[str, float]
) -> Protection:
    silent = Protection(effect, "not protected", "not stated")
    stated = {
        name: next((p for p in protections if p.effect == effect), silent)
        for name, protections in inputs.items()
    }
    rank = WEAKEST_FIRST.index
    weakest = min((p.treatment for p in stated.values()), key=rank)
    named = {name: p for name, p in stated.items() if p.treatment == weakest}
    errors = [shares[name] * p.error for name, p in stated.items() if p.error is not None]
    error = sum(errors) if effect in LASTING else hypot(*errors)
    why = "; ".join(f"{name}: {p.why}" for name, p in sorted(named.items()))
    return Protection(effect, weakest, why, error if errors else None)
