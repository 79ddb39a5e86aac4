"""Scores results against the known truth of simulated measurements, whoever made the results.

The folder of a measurement holds ``truth.json``, and beside it results: ``result.json`` or
``result_NAME.json``, of which ``angles_rad``, ``deviations`` and ``std`` are needed (SI, k = 1).
With ``covariance``, ``verdict`` and ``not_protected`` a result is judged by all that it says;
without a verdict it counts as ok: it says of nothing that it may be wrong.

An offset that no method can know is removed, and what the method cannot see besides
(``Method.gauge``), from result and truth alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from rotcal_ros.evaluation.compare import Comparison, compare
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, ROTATIONS, unit_of
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.file_numbers import finite_column, finite_columns
from rotcal_ros.foundation.results import Verdict
from rotcal_ros.foundation.untrusted import load_json, read_errors_as, read_text
from rotcal_ros.methods import find_method

TRUTH: Final = "truth.json"
NO_EFFECT: Final = "none"
LEAST: Final = 3
"""Angles that a result needs; those that it leaves out count as if they did not hold the truth."""
ROUNDED_ANGLE: Final = 1e-6
"""rad; angles of a result may differ so much from those of the truth."""


@dataclass(frozen=True, eq=False)
class _Curves:
    """``deviations`` (n,) by component at ``angles`` (n,), and what a result says of them.

    That are their ``covariance`` (n, n), its ``verdict``, and the effects that it does not see.
    """

    angles: Floats
    deviations: Mapping[str, Floats]
    covariance: Mapping[str, Floats] = field(default_factory=dict)
    verdict: Verdict = "ok"
    not_protected: tuple[str, ...] = ()


@dataclass(frozen=True)
class Score:
    """One component of one result against the truth of one measurement.

    ``largest`` and ``rms`` are of its errors, ``uncertainty`` is the rms of the stated U (k = 2),
    all m or rad. Of ``n`` intervals ``held`` hold the truth. ``agree``: no more of them fail than
    chance explains, in one sound curve of a hundred it does not. ``named``: the verdict line names
    the effect. ``case`` is the folder of the measurement.
    """

    case: str
    method: str
    effect: str
    entry: str
    component: str
    largest: float
    rms: float
    uncertainty: float
    held: int
    n: int
    agree: bool
    verdict: str
    named: bool

    @property
    def says_ok(self) -> bool:
        """Whether the result says that it is right."""
        return self.verdict == "ok"

    @property
    def misleads(self) -> bool:
        """Whether the result says ok, does not name the effect, and is wrong by more than U."""
        return self.says_ok and not self.agree and not self.named

    def describe(self) -> str:
        """Return what the result claims and what is true of it, in one line."""
        factor, unit = unit_of(self.component)
        says = self.verdict + (f", not protected against {self.effect}" if self.named else "")
        return (
            f"{self.case}, {self.entry}: {self.component} is off by up to "
            f"{self.largest / factor:.3g} {unit}, U is {self.uncertainty / factor:.3g} {unit}, "
            f"{self.held} of {self.n} intervals hold the truth; it says {says}"
        )


@dataclass(frozen=True)
class LeaderboardRow:
    """What one entry makes of one method: a row of the leaderboard.

    ``quantity`` is rotations or translations; ``rms``, ``largest`` and ``rms_plain`` (of what no
    effect has spoiled, None without such) are in ``unit``. ``ok`` curves say ok;
    ``held`` is the share of their intervals that hold the truth, without those that name the
    effect, None if there are none.
    ``misleading`` and ``named`` count curves that say ok and are wrong by more than U, without and
    with the effect named; ``alarms`` those that do not say ok and are right.
    """

    method: str
    entry: str
    quantity: str
    unit: str
    curves: int
    rms_plain: float | None
    rms: float
    largest: float
    ok: int
    held: float | None
    misleading: int
    named: int
    alarms: int

    @property
    def row(self) -> tuple[str | float | None, ...]:
        """The cells below :data:`HEADINGS`."""
        share = None if self.held is None else 100.0 * self.held
        return (
            self.method, self.entry, f"{self.quantity}/{self.unit}", self.curves, self.rms_plain,
            self.rms, self.largest, self.ok, share, self.misleading, self.named, self.alarms,
        )  # fmt: skip


HEADINGS: Final = (
    "method", "entry", "errors of", "curves", "plain rms", "rms", "largest", "say ok",
    "hold/%", "mislead", "named", "alarms",
)  # fmt: skip
FORMATS: Final = ("", "", "", "d", ".3g", ".3g", ".3g", "d", ".1f", "d", "d", "d")


def score_folder(folder: Path) -> tuple[Score, ...]:
    """Return the scores of all results beside the truths in ``folder`` and below it.

    Raises BagError for files that cannot be read, DataError for results that do not fit.
    """
    cases = sorted(path.parent for path in folder.rglob(TRUTH))
    if not cases:
        raise BagError(
            f"{folder}: there is no {TRUTH} in it or below: give the folder of a data set, of one "
            "of its measurements, or of a simulated session"
        )
    scores = tuple(score for case in cases for score in _score_case(case, folder))
    if not scores:
        raise DataError(
            f"{folder}: no result beside any of {len(cases)} {TRUTH}: put yours there as "
            "result_NAME.json"
        )
    return scores


def _score_case(case: Path, folder: Path) -> Iterator[Score]:
    document = read_document(case / TRUTH)
    truth = _read(case / TRUTH, document, _true_curves)
    effect = str(document.get("effect", NO_EFFECT))
    name = str(case.relative_to(folder)) if case != folder else case.name
    for path in sorted(case.glob("result*.json")):
        entry = path.stem.removeprefix("result").removeprefix("_") or "result"
        given = read_document(path)
        method = str(document.get("method") or given.get("method", ""))
        curves = _read(path, given, _stated_curves)
        for component, comparison in _compared(path, curves, truth, method):
            inside = np.abs(comparison.normalised_error) <= 1.0
            yield Score(
                case=name,
                method=method,
                effect=effect,
                entry=entry,
                component=component,
                largest=float(np.abs(comparison.difference).max()),
                rms=comparison.rms,
                uncertainty=COVERAGE_FACTOR * float(np.sqrt(np.mean(comparison.std**2))),
                held=int(inside.sum()),
                n=len(truth.angles),
                agree=comparison.agree,
                verdict=curves.verdict,
                named=effect in curves.not_protected,
            )


def _compared(
    path: Path, given: _Curves, truth: _Curves, method: str
) -> Iterator[tuple[str, Comparison]]:
    """Yield the comparison with the truth of each component that both have."""
    rows = _rows(path, given.angles, truth.angles)
    true = {name: values[rows] for name, values in truth.deviations.items()}
    common = [name for name in COMPONENTS if name in given.deviations and name in true]
    if not common:
        raise DataError(
            f"{path}: deviations holds {', '.join(given.deviations) or 'nothing'}, {TRUTH} "
            f"{', '.join(true) or 'nothing'}: none in common"
        )
    if method:
        gauge = find_method(method).gauge
        found, true = gauge(given.angles, given.deviations), gauge(given.angles, true)
    else:
        found = dict(given.deviations)
    nothing = np.zeros((len(rows),) * 2)
    for name in common:
        first = MeasuredCurve(given.angles, found[name], given.covariance[name], 0.0)
        yield name, compare(first, MeasuredCurve(given.angles, true[name], nothing, 0.0))


def _rows(path: Path, given: Floats, true: Floats) -> list[int]:
    """Return which of the ``true`` angles (n,) rad the ``given`` ones are, in order."""
    near = np.abs(given[:, None] - true) <= ROUNDED_ANGLE
    unknown = given[~near.any(axis=1)]
    rows: list[int] = near.argmax(axis=1).tolist()
    if unknown.size:
        raise DataError(
            f"{path}: angles_rad holds {unknown[0]:.6g}, which is none of the {len(true)} angles "
            f"of {TRUTH}, {true[0]:.6g} to {true[-1]:.6g}: are these degrees, or another table?"
        )
    if len(rows) < LEAST or rows != sorted(set(rows)):
        raise DataError(
            f"{path}: angles_rad holds {len(given)} angles: expected those of {TRUTH} in their "
            f"order, each once, and at least {LEAST}"
        )
    return rows


def read_document(path: Path) -> Mapping[str, Any]:
    """Return the entries of a JSON file; BagError or DataError where it holds none."""
    with read_errors_as(path, BagError):
        text = read_text(path)
    try:
        content = load_json(text)
    except ValueError as error:
        raise BagError(f"{path} is not JSON: {error}; write it anew") from error
    if not isinstance(content, Mapping):
        raise DataError(f"{path}: expected a group of entries")
    return content


def _read(
    path: Path, document: Mapping[str, Any], read: Callable[[Mapping[str, Any]], _Curves]
) -> _Curves:
    try:
        return read(document)
    except KeyError as error:
        raise DataError(f"{path}: the entry {error} is missing; add it") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"{path}: {error}; correct it") from error


def _true_curves(document: Mapping[str, Any]) -> _Curves:
    angles = finite_column(document["angles_rad"], "angles_rad")
    return _Curves(angles, _by_component(document, "deviations", angles.shape))


def _stated_curves(document: Mapping[str, Any]) -> _Curves:
    curves = _true_curves(document)
    n = len(curves.angles)
    stated = _by_component(document, "std", (n,))
    if missing := curves.deviations.keys() - stated.keys():
        raise ValueError(f"std: {', '.join(sorted(missing))} is missing")
    whole = _by_component(document, "covariance", (n, n)) if "covariance" in document else {}
    covariance = {name: whole.get(name, np.diag(std**2)) for name, std in stated.items()}
    verdict, unseen = document.get("verdict", "ok"), document.get("not_protected", [])
    if verdict not in get_args(Verdict):
        raise ValueError(f"verdict: {verdict!r:.60} is none of {', '.join(get_args(Verdict))}")
    if not isinstance(unseen, list):
        raise ValueError(f"not_protected: expected a list of effects, found {unseen!r:.60}")
    effects = tuple(map(str, unseen))
    return replace(curves, covariance=covariance, verdict=verdict, not_protected=effects)


def _by_component(
    document: Mapping[str, Any], entry: str, shape: tuple[int, ...]
) -> dict[str, Floats]:
    """Return an array of ``shape`` for each component in an entry."""
    if not isinstance(document[entry], Mapping):
        raise ValueError(f"{entry}: expected values by component")
    ours = {name: values for name, values in document[entry].items() if name in COMPONENTS}
    return finite_columns(ours, entry, shape)


def leaderboard(scores: Iterable[Score]) -> tuple[LeaderboardRow, ...]:
    """Return the leaderboard: the rows of one method together, the smallest rms first."""
    groups: dict[tuple[str, str, str], list[Score]] = {}
    for score in scores:
        quantity = "rotations" if score.component in ROTATIONS else "translations"
        groups.setdefault((score.method, quantity, score.entry), []).append(score)
    rows = [_row(*key, group) for key, group in groups.items()]
    return tuple(sorted(rows, key=lambda row: (row.method, row.quantity, row.rms)))


def _row(method: str, quantity: str, entry: str, scores: list[Score]) -> LeaderboardRow:
    factor, unit = unit_of(scores[0].component)
    claims = [score for score in scores if score.says_ok and not score.named]
    plain = [score for score in scores if score.effect == NO_EFFECT]
    return LeaderboardRow(
        method=method,
        entry=entry,
        quantity=quantity,
        unit=unit,
        curves=len(scores),
        rms_plain=_rms(plain) / factor if plain else None,
        rms=_rms(scores) / factor,
        largest=max(score.largest for score in scores) / factor,
        ok=sum(score.says_ok for score in scores),
        held=sum(s.held for s in claims) / sum(s.n for s in claims) if claims else None,
        misleading=sum(score.misleads for score in scores),
        named=sum(score.says_ok and not score.agree and score.named for score in scores),
        alarms=sum(not score.says_ok and score.agree for score in scores),
    )


def _rms(scores: list[Score]) -> float:
    return float(np.sqrt(np.mean([score.rms**2 for score in scores])))
