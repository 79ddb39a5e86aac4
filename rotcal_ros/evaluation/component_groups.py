"""Components that are combined together, their consistency, and what is done without it.

What an input cannot know is free: its offset in every component, and in the pairs EXC, EYC and
EAC, EBC the part that turns with the table, as a shifted or tilted plate would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
from scipy.linalg import block_diag

from rotcal_ros.arrays import Floats
from rotcal_ros.components import unit_of
from rotcal_ros.curves.measured import MeasuredCurve
from rotcal_ros.errors import DataError
from rotcal_ros.evaluation.joined_angles import Joined, join_angles
from rotcal_ros.evaluation.pooling import Part, Pooled, common_std, farthest, pool, widened
from rotcal_ros.methods.distributions import chi2_sf

Curves = Mapping[str, MeasuredCurve]
"""Curves of one input by component."""
Enlargement = Literal["birge", "mandel-paule", "none"]
ENLARGEMENTS: Final[tuple[Enlargement, ...]] = get_args(Enlargement)
PAIRS: Final = (("EXC", "EYC"), ("EAC", "EBC"))
"""Components in which a shifted or tilted plate turns together."""
GROUPS: Final = (PAIRS[0], ("EZC",), PAIRS[1], ("ECC",))
_IN_PHASE: Final = 1e-9
"""A turning part below this share of the curve was taken off by the method."""


@dataclass(frozen=True, eq=False)
class Group:
    """Components that were combined together, and what came of it.

    ``joined`` holds the angles of each component, ``columns`` its place among the unknowns;
    ``inputs`` are names. ``chi2``, ``dof`` and ``p_value`` are those of the stated uncertainties.
    ``factor`` multiplies the standard uncertainties (Birge), ``common_std`` was added to those
    of all values (Mandel and Paule), rad or m. ``farthest`` is the input that fits worst.
    """

    inputs: tuple[str, ...]
    joined: Mapping[str, Joined]
    columns: Mapping[str, slice]
    pooled: Pooled
    chi2: float
    dof: int
    p_value: float
    consistent: bool
    enlargement: Enlargement = "none"
    factor: float = 1.0
    common_std: float = 0.0
    farthest: str = ""

    interpolated: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The components in words."""
        return ", ".join(self.joined)

    @property
    def weights(self) -> dict[str, float]:
        """Mean share of each input in the variance of the estimates, by its name; sum 1."""
        parts = self.pooled.variance_parts.mean(axis=1)
        return dict(zip(self.inputs, parts.tolist(), strict=True))

    def values(self, component: str) -> Floats:
        """Return the estimate (n,) of one component, m or rad."""
        return self.pooled.values[self.columns[component]]

    def covariance(self, component: str) -> Floats:
        """Return the covariance (n, n) of one component, enlarged where it had to be."""
        own = self.columns[component]
        return self.factor**2 * self.pooled.covariance[own, own]

    def in_words(self) -> str:
        """Return that the inputs contradict each other, and what was done about it."""
        unit, label = unit_of(next(iter(self.joined)))
        done = {
            "birge": f"uncertainties enlarged by the factor {self.factor:.3g} (Birge)",
            "mandel-paule": f"{self.common_std / unit:.3g} {label} added to the standard "
            "uncertainty of every value (Mandel-Paule)",
            "none": "uncertainties not enlarged",
        }
        off = f"; {self.farthest} is farthest off" if self.farthest else ""
        return (
            f"{self.name}: the inputs contradict each other (chi-square {self.chi2:.4g} with "
            f"{self.dof} degrees of freedom, p = {self.p_value:.2g}{off}): "
            f"{done[self.enlargement]}"
        )


def combine_group(
    components: Sequence[str], inputs: Mapping[str, Curves], enlarge: Enlargement, level: float
) -> Group:
    """Combine ``components`` of all ``inputs`` (by name), of which each has one at least.

    They are consistent when chance gives a larger chi-square more often than ``level``; if not,
    the uncertainties are enlarged. Raises DataError for inputs that cannot be joined.
    """
    joined = {c: join_angles([inputs[name][c] for name in _with(c, inputs)]) for c in components}
    columns, start = {}, 0
    for c in components:
        columns[c] = slice(start, start + len(joined[c].angles))
        start = columns[c].stop
    parts = [_part(name, inputs, joined, columns) for name in inputs]
    gauge = unknown({c: joined[c].angles for c in components})
    try:
        pooled = pool(parts, gauge)
    except DataError as error:
        raise DataError(f"{', '.join(components)} of {', '.join(inputs)}: {error}") from error
    p_value = chi2_sf(pooled.chi2, pooled.dof) if pooled.dof else 1.0
    group = Group(
        inputs=tuple(inputs),
        joined=joined,
        columns=columns,
        pooled=pooled,
        chi2=pooled.chi2,
        dof=pooled.dof,
        p_value=p_value,
        consistent=p_value >= level,
        interpolated=tuple(
            name
            for c in components
            for name, between in zip(_with(c, inputs), joined[c].interpolated, strict=True)
            if between
        ),
    )
    return group if group.consistent else _enlarged(group, parts, gauge, enlarge)


def _enlarged(group: Group, parts: Sequence[Part], gauge: Floats, enlarge: Enlargement) -> Group:
    """Return a group whose inputs contradict each other with larger uncertainties."""
    if len(parts) > 2:
        group = replace(group, farthest=group.inputs[farthest(parts, gauge)])
    if enlarge == "birge":
        factor = float(np.sqrt(group.chi2 / group.dof))
        return replace(group, enlargement=enlarge, factor=factor)
    if enlarge == "mandel-paule":
        extra = common_std(parts, gauge)
        wider = pool(widened(parts, extra**2), gauge)
        return replace(group, enlargement=enlarge, common_std=extra, pooled=wider)
    return group


def _with(component: str, inputs: Mapping[str, Curves]) -> list[str]:
    """Return the names of the inputs that measured a component."""
    return [name for name, curves in inputs.items() if component in curves]


def _part(
    name: str,
    inputs: Mapping[str, Curves],
    joined: Mapping[str, Joined],
    columns: Mapping[str, slice],
) -> Part:
    """Return what one input says about the unknowns of a group."""
    own = {c: inputs[name][c] for c in joined if c in inputs[name]}
    width = max(column.stop for column in columns.values())
    angles, values, covariances, designs = {}, {}, {}, []
    for c, curve in own.items():
        place = _with(c, inputs).index(name)
        rows = joined[c].rows[place]
        design = np.zeros((len(rows), width))
        design[:, columns[c]] = joined[c].designs[place]
        designs.append(design)
        angles[c], values[c] = curve.angles[rows], curve.deviation[rows]
        covariances[c] = curve.covariance[np.ix_(rows, rows)]
    if len(own) == 2:
        covariances = _with_turning(angles, values, covariances)
    return Part(
        values=np.concatenate(list(values.values())),
        covariance=block_diag(*covariances.values()),
        design=np.concatenate(designs),
        free=unknown(angles),
    )


def unknown(angles: Mapping[str, Floats]) -> Floats:
    """Return an orthonormal basis (m, q) of what no method knows, at ``angles`` by component.

    An offset of every component and, for a pair or one of it, a plate that is shifted or tilted:
    a cos t - b sin t in the first, a sin t + b cos t in the second component.
    """
    columns = [_stacked(angles, lambda t, c, own=own: np.full(len(t), c == own)) for own in angles]
    seconds = [second for _, second in PAIRS]
    if any(c in pair for pair in PAIRS for c in angles):
        columns.append(_stacked(angles, lambda t, c: np.sin(t) if c in seconds else np.cos(t)))
        columns.append(_stacked(angles, lambda t, c: np.cos(t) if c in seconds else -np.sin(t)))
    u, s, _ = np.linalg.svd(np.column_stack(columns), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]], dtype=np.float64)


def _stacked(angles: Mapping[str, Floats], of: Callable[..., Floats]) -> Floats:
    return np.concatenate([of(t, c) for c, t in angles.items()]).astype(np.float64)


def _with_turning(
    angles: Mapping[str, Floats], values: Mapping[str, Floats], covariances: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Return the covariances of a pair as they were before its turning part was taken off.

    A result holds no covariance between components. Where a method has removed what turns with
    the table, the first harmonics of each component alone show only the half of their variance
    that is left: what turns the other way has kept all of it. Doubling restores that; what turns
    with the table is free and does not feel it.
    """
    first, second = angles.values()
    x, y = values.values()
    if len(first) != len(second) or np.max(np.abs(first - second)) > _IN_PHASE:
        return dict(covariances)
    pair = x - x.mean() + 1j * (y - y.mean())
    if abs(np.mean(pair * np.exp(-1j * first))) > _IN_PHASE * np.max(np.abs(pair)):
        return dict(covariances)
    basis = np.column_stack([np.ones_like(first), np.cos(first), np.sin(first)])
    # The first column is the constant, which stays as it is.
    harmonic = np.linalg.qr(basis)[0][:, 1:]
    grow = np.eye(len(first)) + (np.sqrt(2.0) - 1.0) * harmonic @ harmonic.T
    return {c: grow @ covariance @ grow for c, covariance in covariances.items()}
