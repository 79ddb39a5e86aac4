"""From the results of a table to series of comparable curves, one for each deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import Final

import numpy as np

from rotcal_history.database import EVENT, Campaign, HistoryEntry
from rotcal_history.settings import CUTTING
from rotcal_history.trend import CampaignSeries
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, TRANSLATIONS
from rotcal_ros.foundation.curves.interpolation import harmonic_basis, harmonic_estimator
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError

ORDERS: Final = 6
"""Modes that may move; what is finer stays as the newest curve has it."""
NEWEST: Final = 100
"""Campaigns of a series: older ones say nothing of the future of a table."""
SAME_ARC: Final = 0.01
"""Arcs whose ends differ by less than this share are one."""
EXACT: Final = 1e-4


@dataclass(frozen=True, eq=False)
class DeviationSeries:
    """The curves of one deviation since the last event that made the table another one.

    ``campaigns`` (m) are those of ``series``. A curve at the angles of the newest one is ``rest``
    plus ``basis`` (n, p) times the coefficients; ``rest`` (n,) with ``rest_covariance`` (n, n) is
    what the modes leave of the newest. All of them are zero at the angle ``zero``, whose
    deviation is zero by definition; None if there is none.
    """

    component: str
    campaigns: tuple[Campaign, ...]
    series: CampaignSeries
    basis: Floats
    rest: Floats
    rest_covariance: Floats
    zero: int | None
    notes: tuple[str, ...]

    @property
    def newest(self) -> MeasuredCurve:
        """The newest curve."""
        return self.campaigns[-1].curves[self.component]

    @property
    def tolerance(self) -> float:
        """The tolerance (rad or m) that the newest result states; 0: none."""
        newest = self.campaigns[-1]
        return newest.tolerance_m if self.component in TRANSLATIONS else newest.tolerance_rad

    def curves_of(self, coefficients: Floats, rest: Floats) -> Floats:
        """Return curves (..., n) of coefficients (..., p) and of what they leave."""
        return np.asarray(rest + coefficients @ self.basis.T, dtype=np.float64)

    def draw_residuals(self, draws: int) -> Floats:
        """Return draws (draws, 1, n) of what the modes leave."""
        values, vectors = np.linalg.eigh(self.rest_covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        deviates = np.random.default_rng(106).standard_normal((draws, 1, len(self.rest)))
        return np.asarray(self.rest + deviates @ root.T, dtype=np.float64)


def make_deviation_series(
    campaigns: Sequence[Campaign], entries: Sequence[HistoryEntry], common_share: float
) -> dict[str, DeviationSeries]:
    """Return the series of each deviation of campaigns in order of time.

    What counts are the newest NEWEST since the last cut that are ok, and no simulated ones beside
    real ones. At an event, and where the table in force changes, the level may jump. A deviation
    whose curves cannot be compared is left out.
    """
    events = [e for e in entries if e.kind == EVENT]
    jumps = [e.measured_ns for e in events]
    cuts = [e.measured_ns for e in events if e.what in CUTTING]
    good = [c for c in campaigns if c.verdict == "ok" and c.measured_ns >= max(cuts, default=-inf)]
    counting = ([c for c in good if not c.simulated] or good)[-NEWEST:]
    having = {name: [c for c in counting if name in c.curves] for name in COMPONENTS}
    found = {n: _series(n, those, jumps, common_share) for n, those in having.items() if those}
    return {name: series for name, series in found.items() if series is not None}


def _series(
    component: str, campaigns: Sequence[Campaign], jumps: Sequence[int], common_share: float
) -> DeviationSeries | None:
    newest = campaigns[-1].curves[component]
    alike = [c for c in campaigns if _comparable(c.curves[component], newest)]
    able = {c.entry_id: (len(c.curves[component].angles) - 1) // 2 for c in alike}
    orders = min(ORDERS, int(np.median(list(able.values()))), able[campaigns[-1].entry_id])
    kept = [c for c in alike if able[c.entry_id] >= orders > 0]
    try:
        estimators = [_modes(c.curves[component], orders)[1][1:] for c in kept]
    except DataError:
        return None
    fits = [(c.curves[component], e) for c, e in zip(kept, estimators, strict=True)]
    variances = np.array([_variances(curve, e) for curve, e in fits])
    if not fits or not np.all(variances > 0.0):
        return None
    basis = _modes(newest, orders)[0][:, 1:]
    left = np.eye(len(newest.angles)) - basis @ estimators[-1]
    zeros = np.flatnonzero(np.diag(newest.covariance) <= 0.0)
    zero = int(zeros[0]) if len(zeros) == 1 else None
    if zero is not None:
        basis, left = basis - basis[zero], left - left[zero]
    numbers = np.arange(1, orders + 1)
    temperatures = [c.temperature_c for c in kept]
    series = CampaignSeries(
        times_ns=np.array([c.measured_ns for c in kept], dtype=np.int64),
        values=np.array([e @ curve.deviation for curve, e in fits]),
        std=np.sqrt(variances),
        orders=np.repeat(numbers, 2) if newest.period else numbers,
        steps=_steps(kept, jumps),
        common=_common(kept, common_share),
        temperature_c=None if None in temperatures else np.array(temperatures, dtype=np.float64),
    )
    dropped = len(campaigns) - len(kept)
    words = f"{dropped} of {len(campaigns)} results of {component}: too few angles, or another arc"
    notes = (words,) if dropped else ()
    return DeviationSeries(
        component, tuple(kept), series, basis, left @ newest.deviation,
        left @ newest.covariance @ left.T, zero, notes,
    )  # fmt: skip


def _comparable(curve: MeasuredCurve, newest: MeasuredCurve) -> bool:
    """Return whether two curves are of the same circle, or of the same arc."""
    ends, apart = newest.angles[[0, -1]], SAME_ARC * float(np.ptp(newest.angles))
    same = bool(curve.period) or np.allclose(curve.angles[[0, -1]], ends, rtol=0.0, atol=apart)
    return curve.period == newest.period and bool(same)


def _variances(curve: MeasuredCurve, estimator: Floats) -> Floats:
    """Return the variances (p,) of the modes of a curve.

    A curve with fewer parameters than modes states some of them as exact: of each at least the
    share EXACT is kept of what equal and independent deviations would leave.
    """
    stated = np.diag(estimator @ curve.covariance @ estimator.T)
    white = np.sum(estimator**2, axis=1) * np.mean(np.diag(curve.covariance))
    return np.asarray(np.maximum(stated, EXACT * white), dtype=np.float64)


def _modes(curve: MeasuredCurve, orders: int) -> tuple[Floats, Floats]:
    """Return the modes (n, 1 + p) of a curve, a constant first, and their estimator (1 + p, n)."""
    if curve.period:
        basis = harmonic_basis(curve.angles, orders)
        return basis, harmonic_estimator(curve.angles, orders, curve.covariance)
    share = (curve.angles - curve.angles[0]) / np.ptp(curve.angles)
    basis = np.cos(np.pi * np.outer(share, np.arange(orders + 1)))
    size = np.trace(curve.covariance) / len(share)
    regular = curve.covariance + size * (1.0 + 1e-9 * np.eye(len(share)))
    weighted = np.linalg.solve(regular, basis)
    return basis, np.linalg.solve(basis.T @ weighted, weighted.T)


def _steps(campaigns: Sequence[Campaign], jumps: Sequence[int]) -> Ints:
    """Count the jumps before each campaign: events, and other tables in force."""
    count = np.zeros(len(campaigns), dtype=np.int64)
    for i, (before, after) in enumerate(pairwise(campaigns), 1):
        between = any(before.measured_ns < t <= after.measured_ns for t in jumps)
        count[i] = count[i - 1] + (between or before.measured_on != after.measured_on)
    return count


def _common(campaigns: Sequence[Campaign], share: float) -> Floats:
    """Return the shares (m, m) of the variances that campaigns have in common.

    Of ``share`` each kind of instrument has an equal part; it is in common if both state the
    same serial number.
    """
    used: list[Mapping[str, str]] = [c.instruments for c in campaigns]
    kinds = sorted({kind for each in used for kind in each})
    common = np.zeros((len(used), len(used)))
    for kind in kinds:
        serials = np.array([each.get(kind, f"unknown {i}") for i, each in enumerate(used)])
        common += share / len(kinds) * (serials[:, None] == serials)
    return common + np.diag(1.0 - np.diag(common))
