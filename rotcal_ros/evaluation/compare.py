"""Tests whether two deviation curves of one table agree within their uncertainties.

Differences are aligned by the offset that no method can know: their mean is subtracted. The
uncertainty of that mean and its correlation with every value are part of the divisor of the
normalised error E_n (ISO/IEC 17043, k = 2).

It also suggests why two curves disagree altogether: a wrong unit, sign or sense of rotation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from math import pi
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import binomial_quantile, chi2_sf, normal_sf
from rotcal_ros.evaluation.common_angles import (
    PairedCurves,
    covariance_floor,
    pair_curves,
    with_observation_noise_only,
)
from rotcal_ros.foundation.arrays import Bools, Floats, std_of
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.curves.interpolation import (
    harmonic_basis,
    interpolation_matrix,
    orthonormal_harmonic_basis,
    regularised_cholesky,
)
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.dataframes import ByAngle
from rotcal_ros.foundation.gum_numbers import uncertainty, value
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.results import json_fields
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN

SURE: Final = 0.01
"""Two curves disagree if chance alone makes such differences less often than this."""
OFFSETS_OFF: Final = noted("{0}: {1}; such offsets are removed, like the zero")
TOO_ALIKE: Final = (
    "they agree better than independent measurements would: the same data, a common error, or "
    "uncertainties stated too large"
)


@dataclass(frozen=True, eq=False)
class Comparison(ByAngle):
    """First minus second at ``angles`` (n,) rad, in the unit of the curves (rad or m).

    ``difference`` is aligned, ``std`` its standard uncertainty (k = 1) after the alignment,
    ``normalised_error`` = difference / (2 std). ``interpolated`` marks angles at which the second
    curve was not measured. ``offset`` was removed. ``chi2`` has ``dof`` degrees of freedom and
    uses all correlations; ``p_value`` is how often chance alone gives more.
    """

    angles: Floats
    difference: Floats
    std: Floats
    normalised_error: Floats
    interpolated: Bools
    offset: float
    rms: float
    chi2: float
    dof: int
    p_value: float
    agree: bool
    notes: tuple[Phrase, ...]

    def __repr__(self) -> str:
        """Return in one line whether the curves agree; without their unit, which is not known."""
        counts = f"{len(self.angles)} angles, largest |E_n| {self.largest:.2f}"
        chance = f"chi2/dof {self.chi2:.4g}/{self.dof}, p {self.p_value:.2g}"
        return f"<Comparison: {'agree' if self.agree else 'DISAGREE'}, {counts}, {chance}>"

    @property
    def largest(self) -> float:
        """The largest |E_n|."""
        return float(np.max(np.abs(self.normalised_error)))

    def describe(self, unit: float = ARCSEC, unit_name: str = "arcsec") -> Phrase:
        """Return the verdict in one line."""
        worst = int(np.argmax(np.abs(self.normalised_error)))
        above = int(np.sum(np.abs(self.normalised_error) > 1.0))
        return phrase(
            "{0}: rms {1:.3g} {2}, largest |E_n| {3:.2f} at {4:.6g} deg, {5} of {6} above 1, "
            "chi2/dof {7:.2f}", phrase("agree") if self.agree else phrase("DISAGREE"),
            self.rms / unit, unit_name, abs(self.normalised_error[worst]),
            self.angles[worst] / DEGREE, above, len(self.angles), self.chi2 / self.dof
        )  # fmt: skip

    def rows(self, unit: float) -> list[tuple[str, str, str, str]]:
        """Return angle (deg), difference, expanded uncertainty (k = 2) and E_n as text."""
        columns = (self.angles, self.difference, self.std, self.normalised_error)
        return [
            (
                f"{angle / DEGREE:.4f}",
                value(difference / unit, COVERAGE_FACTOR * std / unit),
                uncertainty(COVERAGE_FACTOR * std / unit),
                f"{error:+.2f}",
            )
            for angle, difference, std, error in zip(*columns, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON."""
        return json_fields(self)


def compare(
    first: MeasuredCurve,
    second: MeasuredCurve,
    align_order: int = 0,
    names: tuple[str, str] = ("first", "second"),
) -> Comparison:
    """Compare two curves at the angles of the one that has fewer.

    What rests on the same observations varies together, see :mod:`.common_angles`. Where the other
    was not measured it is interpolated by its spline, marked and noted. ``align_order`` takes
    off, beside the offset, so many harmonics that the two methods define differently (1 for
    radial deviations with another origin). The notes name, by ``names``, each curve whose verdict
    is not a bare ok: two may agree in an error that neither can see. Raises DataError with fewer
    common angles than the alignment needs.
    """
    if len(second.angles) < len(first.angles):
        turned = compare(second, first, align_order, (names[1], names[0]))
        return replace(
            turned,
            difference=-turned.difference,
            normalised_error=-turned.normalised_error,
            offset=-turned.offset,
        )
    both = pair_curves(first, second, names)
    angles, raw = both.angles, both.first - both.second
    covariance = _of_difference(both)
    exact = not np.any(covariance)
    basis = orthonormal_harmonic_basis(angles, align_order, both.free)
    difference, std, chi2, dof = _align(raw, covariance, basis)
    normalised = _normalised(difference, std)
    p_value = 0.0 if exact and np.any(normalised) else chi2_sf(chi2, dof)
    agree = _agree(normalised, p_value)
    least = chi2
    if both.shared is None and not exact:
        own = with_observation_noise_only
        bare = pair_curves(own(first), own(second), names)
        least = _align(raw, _of_difference(bare), basis)[2]
    doubts = [
        phrase(OFFSETS_OFF if curve.open_zeros else "{0}: {1}", name, curve.verdict_line)
        for name, curve in zip(names, (first, second), strict=True)
        if curve.verdict_line not in ("", "ok")
    ]
    why = None if agree else _suspicion(both, second)
    alike = [phrase("{0} (chi2/dof {1:.2f})", phrase(TOO_ALIKE), least / dof)] * (
        not exact and agrees_too_well(least, dof)
    )
    return Comparison(
        angles=angles,
        difference=difference,
        std=std,
        normalised_error=normalised,
        interpolated=both.interpolated,
        offset=float(np.linalg.lstsq(harmonic_basis(angles, align_order), raw, rcond=None)[0][0]),
        rms=float(np.sqrt(np.mean(difference**2))),
        chi2=chi2,
        dof=dof,
        p_value=p_value,
        agree=agree,
        notes=(*doubts, *_notes(both, why, exact), *alike),
    )


def _of_difference(both: PairedCurves) -> Floats:
    """Return the covariance (n, n) of first - second."""
    covariance = both.first_covariance + both.second_covariance
    if both.shared is None:
        return covariance
    apart = covariance - both.shared - both.shared.T
    return np.asarray(apart + covariance_floor(0.5 * covariance), dtype=np.float64)


def _align(raw: Floats, covariance: Floats, basis: Floats) -> tuple[Floats, Floats, float, int]:
    """Return aligned difference, its std, chi-square and degrees of freedom.

    The differences (n,) and their covariance are projected, unweighted, on what the unknowns
    cannot explain. So the outcome does not depend on where either curve has its zero: a weighted
    alignment would depend most on the angle whose value is zero by definition.
    """
    n, unknowns = basis.shape
    keep = np.eye(n) - basis @ basis.T
    aligned = keep @ raw
    std = std_of(keep @ covariance @ keep)
    if not np.any(covariance):
        return aligned, std, 0.0, n - unknowns
    root = regularised_cholesky(covariance)
    white = np.linalg.solve(root, aligned)
    q, _ = np.linalg.qr(np.linalg.solve(root, basis))
    return aligned, std, float(np.sum((white - q @ (q.T @ white)) ** 2)), n - unknowns


def compare_all(
    curves: Mapping[str, MeasuredCurve], align_order: int = 0
) -> dict[tuple[str, str], Comparison]:
    """Compare every pair of ``curves``; the keys are pairs of their names."""
    return {
        (a, b): compare(curves[a], curves[b], align_order, (a, b))
        for a, b in combinations(curves, 2)
    }


def _suspicion(both: PairedCurves, second: MeasuredCurve) -> Phrase | None:
    """Return what may be wrong with one of two curves, the second one mirrored, too."""
    mirrored = None
    if second.period:
        mirrored = -interpolation_matrix(second.angles, -both.angles, TURN) @ second.deviation
    return suspected_cause(both.first, both.second, mirrored)


def _agree(normalised: Floats, p_value: float) -> bool:
    """Return whether |E_n| exceeds 1 no more often than by chance, singly and together."""
    above = int(np.sum(np.abs(normalised) > 1.0))
    expected = 2.0 * normal_sf(COVERAGE_FACTOR)  # E_n has k = 2 in it: above 1 is beyond 2 sigma
    usual = above <= binomial_quantile(1.0 - SURE, len(normalised), expected)
    return above == 0 or (usual and p_value >= SURE)


def _normalised(difference: Floats, std: Floats) -> Floats:
    """Return E_n; without any uncertainty a difference is infinitely large."""
    tiny = np.finfo(np.float64).tiny
    zero = np.abs(difference) <= 1e-15
    scaled = difference / np.maximum(COVERAGE_FACTOR * std, tiny)
    return np.asarray(np.where(zero, 0.0, np.clip(scaled, -1e6, 1e6)), dtype=np.float64)


def _notes(both: PairedCurves, why: Phrase | None, exact: bool) -> list[Phrase]:
    notes = []
    if np.any(both.interpolated):
        notes.append(
            phrase(
                "{0} of {1} angles were not measured by both: interpolated there",
                int(np.sum(both.interpolated)),
                len(both.angles),
            )
        )
    if both.outside:
        notes.append(phrase("{0} angles lie outside the other's arc: left out", both.outside))
    if both.shared is not None:
        notes.append(phrase("both use some of the same observations, which is taken into account"))
    if exact:
        notes.append(phrase("neither curve states an uncertainty: E_n is meaningless"))
    if why:
        notes.append(why)
    return notes


def agrees_too_well(chi2: float, dof: int, level: float = SURE) -> bool:
    """Return whether chance makes so small a chi-square less often than ``level``."""
    return dof > 0 and 1.0 - chi2_sf(chi2, dof) < level


ALIKE: Final = 0.9
"""Correlation above which two curves have the same shape."""
SCALES: Final = {
    3600.0: "degrees taken for arcseconds",
    180.0 / pi * 3600.0: "radians taken for arcseconds",
    60.0: "arcminutes taken for arcseconds",
    180.0 * 3600.0 / pi / 1e6: "microradians and arcseconds exchanged",
}


def suspected_cause(
    first: Floats, second: Floats, second_mirrored: Floats | None
) -> Phrase | None:
    """Return what may be wrong with one of two curves, if their shapes show it.

    ``first`` and ``second`` are the values at the same angles, ``second_mirrored`` the negative
    values of the second curve at the negative angles, if it covers a full turn.
    """
    if second_mirrored is not None:
        straight, mirrored = _likeness(first, second), _likeness(first, second_mirrored)
        if mirrored > ALIKE and mirrored > abs(straight) + 0.2:
            return phrase("the curves fit if one is reversed: is its angle counted clockwise?")
    likeness = _likeness(first, second)
    if abs(likeness) < ALIKE:
        return None
    ratio = float(np.std(first) / np.std(second))
    mistakes = [phrase("its sign is reversed (commanded - actual?)")] * (likeness < 0.0)
    for factor, mistake in SCALES.items():
        if abs(ratio / factor - 1.0) < 0.2 or abs(ratio * factor - 1.0) < 0.2:
            mistakes.append(phrase(mistake))
            break
    if not mistakes:
        return None
    return phrase("both curves have one shape, but for one of them {0}", join_texts(mistakes))


def _likeness(first: Floats, second: Floats) -> float:
    a, b = first - np.mean(first), second - np.mean(second)
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0
