"""Models of several instruments that see the same, as one model.

Each instrument's model is brought to unknowns of which the first are those that all share
(:func:`reparametrise`) and to observations in their stated noise (:func:`whiten`), for one
reads lengths and another angles. :func:`stack_models` puts them together: what all share stands
once, everything else belongs to its instrument and bears its name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from rotcal_ros.adjust.designs import Derivatives, dense
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Disturbing, Grouping, Model, Unit
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.language import Phrase, phrase

IN_NOISE: Final = Unit("standard deviations", 1.0)
"""In which people read the observations of several instruments."""


def reparametrise(model: Model, to: Floats, blocks: Mapping[str, int]) -> Model:
    """Return the model of unknowns in ``blocks`` (q,) that ``to`` (p, q) takes to its own."""

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        computed, design = model.equations(to @ x)
        return computed, dense(design) @ to

    return replace(
        model,
        blocks=blocks,
        equations=equations,
        outputs=model.outputs @ to,
        further={name: rows @ to for name, rows in model.further.items()},
        definitions=None if model.definitions is None else model.definitions @ to,
        start=np.asarray(np.linalg.lstsq(to, model.first, rcond=None)[0], dtype=np.float64),
    )


def whiten(model: Model) -> Model:
    """Return the model of observations that are divided by their stated noise."""
    std = model.std

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        computed, design = model.equations(x)
        return computed / std, dense(design) / std[:, None]

    changed = model.changed(
        equations, lambda of: (of.T / std).T, lambda of: (of.T * std).T, apart=True
    )
    correlated = [each.divided(std) for each in model.correlated]
    return replace(changed, std=np.ones(len(std)), unit=IN_NOISE, correlated=correlated)


def stack_models(
    models: Mapping[str, Model], shared: Mapping[str, int], outputs: Floats, words: Words
) -> Model:
    """Return the :func:`whiten` models of several instruments, by their names, as one.

    The first unknowns of each are those in the blocks ``shared`` (s,); ``outputs`` (o, s) are
    those of all. What each determines besides is reported beside its name. Relations that only the
    outputs of one should keep are not asked for.
    """
    width, parts = sum(shared.values()), list(models.values())
    rows = slices_of([m.size[0] for m in parts])
    own = slices_of([m.size[1] - width for m in parts], width)
    n, p = rows[-1].stop, own[-1].stop
    columns = [np.append(np.arange(width), np.arange(u.start, u.stop)) for u in own]
    every = list(zip(models.items(), rows, columns, strict=True))
    begins = np.cumsum([0, *(len(m.components) for m in parts[:-1])]).tolist()
    return Model(
        blocks=_blocks(models, shared),
        observed=np.concatenate([m.observed for m in parts]),
        std=np.ones(n),
        equations=_together(parts, rows, columns, p),
        outputs=np.pad(outputs, ((0, 0), (0, p - width))),
        words=words,
        unit=IN_NOISE,
        start=np.concatenate([np.zeros(width), *(m.first[width:] for m in parts)]),
        further={
            _of(name, what): _spread(np.asarray(further), mine, p)
            for (name, model), _, mine in every
            for what, further in model.further.items()
        },
        components=[_of(name, c) for name, m in models.items() for c in m.components],
        component=np.concatenate([m.of_component + k for m, k in zip(parts, begins, strict=True)]),
        judged=np.concatenate([m.rejectable for m in parts]),
        groupings=[
            _grouping(name, grouping, at, n)
            for (name, model), at, _ in every
            for grouping in model.groupings
        ],
        effects=[
            _disturbing(name, effect, at, n)
            for (name, model), at, _ in every
            for effect in model.effects
        ],
        row_names=_row_names(models, rows),
        correlated=[each.below(at.start) for (_, m), at, _ in every for each in m.correlated],
        element=_elements(parts),
        definitions=_definitions(parts, columns, p),
        expected=[
            each._replace(effect=_disturbing(name, each.effect, at, n))
            for (name, model), at, _ in every
            for each in model.expected
        ],
        unstated=any(m.unstated for m in parts),
        least=max(m.least for m in parts),
    )


def _row_names(models: Mapping[str, Model], rows: Sequence[slice]) -> Callable[[int], str]:
    """Return what names a row of all: as its model does, and of which one it is."""
    each = [
        (at, model.name_of_row, name)
        for at, (name, model) in zip(rows, models.items(), strict=True)
    ]

    def name_of(row: int) -> Phrase:
        at, its_own, name = next(part for part in each if row < part[0].stop)
        return phrase("{0} of {1}", its_own(row - at.start), name)

    return name_of


def _of(name: str, what: str) -> Phrase:
    return phrase("{0} of {1}", phrase(what), name)


def _blocks(models: Mapping[str, Model], shared: Mapping[str, int]) -> dict[str, int]:
    """Return the ``shared`` blocks of unknowns, then those that each model has for itself."""
    blocks = dict(shared)
    for name, model in models.items():
        its_own = list(model.blocks.items())[len(shared) :]
        blocks |= {_of(name, block): size for block, size in its_own}
    return blocks


def _definitions(
    models: Sequence[Model], columns: Sequence[Floats], unknowns: int
) -> Floats | None:
    found = [
        _spread(model.definitions, mine, unknowns)
        for model, mine in zip(models, columns, strict=True)
        if model.definitions is not None
    ]
    return np.concatenate(found) if found else None


def _elements(models: Sequence[Model]) -> Ints | None:
    if all(model.element is None for model in models):
        return None
    first = np.cumsum([0, *(len(m.elements) for m in models)])
    return np.concatenate([m.of_element + k for m, k in zip(models, first, strict=False)])


def _together(
    models: Sequence[Model], rows: Sequence[slice], columns: Sequence[Floats], unknowns: int
) -> Callable[[Floats], tuple[Floats, Derivatives]]:
    """Return the equations of all models: their ``rows``, of their ``columns`` of the unknowns."""
    n = rows[-1].stop

    def equations(x: Floats) -> tuple[Floats, Derivatives]:
        computed, design = np.zeros(n), np.zeros((n, unknowns))
        for model, at, mine in zip(models, rows, columns, strict=True):
            computed[at], derivatives = model.equations(x[mine])
            design[at, mine] = dense(derivatives)
        return computed, design

    return equations


def slices_of(sizes: Iterable[int], first: int = 0) -> list[slice]:
    """Return where parts of such ``sizes`` are that stand one after the other."""
    ends = np.cumsum([first, *sizes]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]


def _spread(rows: Floats, columns: Floats, unknowns: int) -> Floats:
    """Return ``rows`` (k, q) of some unknowns as those of all, (k, p)."""
    found = np.zeros((len(rows), unknowns))
    found[:, columns] = rows
    return found


def _grouping(name: str, grouping: Grouping, at: slice, n: int) -> Grouping:
    """Return the grouping of the rows ``at`` of n, which says in whose observations it is."""
    kind = phrase("{0}, {1}", name, phrase(grouping.kind))
    return grouping._replace(kind=kind).with_others(n - at.stop, at.start)


def _disturbing(name: str, effect: Disturbing, at: slice, n: int) -> Disturbing:
    """Return the effect on the rows ``at`` of n, which says in whose observations it is."""
    return replace(effect, what=phrase("in {0} {1}", name, phrase(effect.what))).beside(
        n - at.stop, at.start
    )
