"""The one form of result that all methods share.

A method takes a frozen problem and returns a :class:`Result`; the solver node, the offline
replay, the report, the comparison and the export never ask which method it was. Deviations are
*actual - commanded*; absent components are absent, never zero.

This module also reads a result from its machine-readable form and checks every entry. What it
returns can be printed, drawn, compared and exported; a file that was cut or edited ends in one
error that names the wrong entry.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from html import escape
from importlib import import_module
from math import isfinite
from typing import Any, Final, Literal, get_args

import numpy as np

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.compact import (
    Spread,
    covariances_from,
    difference_variance,
    kept,
    plain_covariance,
    plain_covariances,
    spread_from,
    variances_of,
    written,
)
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.dataframes import dataframe
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.file_numbers import finite_column, finite_columns, floats
from rotcal_ros.foundation.in_force import UNKNOWN, check_in_force
from rotcal_ros.foundation.language import Phrase, codes_of, join_texts, noted, phrase, with_codes
from rotcal_ros.foundation.protection import BOTH_LINES, Effect, Protection, ordered, unprotected
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.units import DEGREE

SCHEMA: Final = 1
FILE_NAMES: Final = {"table_position": "table_index", "angles": "angles_rad"}
"""Names that files use for something, where they differ from ours."""
_AGAIN: Final = "solve the bag or the table again"
RUNS: Final = "runs"
BUDGET: Final = "budget"
ERROR_MOTION: Final = "error_motion"
"""Where a file has the repeated runs, the budget and the error motion: among the details."""

Verdict = Literal["ok", "suspect", "failed"]
COUNTS_FROM: Final = (
    "first angle",
    "first angle of each group",
    "mean",
    "mean of each group",
    UNKNOWN,
)
"""What the deviations of a method count from: they are zero there, or on average there."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """An observation that was not used: its row ``index`` and the reason."""

    index: int
    why: Phrase


@dataclass(frozen=True, slots=True)
class Residuals:
    """One row per observation, used or not; all arrays have shape (n,).

    ``residual`` is observed - computed in the ``unit`` of the observations, metres for all
    built-in methods; ``redundancy`` lies in [0, 1] and ``test_value`` is the normalised residual
    (dimensionless). Rows that were not used keep their residual against the final solution and
    have ``used`` False. An observation has ``coordinates`` values (a length one, a point three);
    ``std`` is the standard deviation of each as the solution weighs it, in the same unit, rms
    over its coordinates. None: unknown.
    """

    table_position: Ints
    target: Ints
    residual: Floats
    redundancy: Floats
    test_value: Floats
    used: Bools
    std: Floats | None = None
    coordinates: int = 1
    unit: Literal["m", "rad"] = "m"


@dataclass(frozen=True, eq=False, slots=True)
class RepeatedRuns:
    """Deviations of every arrival at ``targets`` (m,) rad in n runs, in radians.

    ``forward`` and ``reverse`` (m, n) are None for a direction without arrivals and NaN where one
    is missing. ``repeatability_std`` is the scatter beyond that of the measurement.
    """

    targets: Floats
    forward: Floats | None
    reverse: Floats | None
    repeatability_std: float | None = None


@dataclass(frozen=True, slots=True)
class ErrorMotion:
    """Standard deviations of the table's error motion per direction in the plane, m.

    ``stated``: None when nothing was stated. ``likely``: the most likely one, from the circle's
    ``dof`` free residuals, ``allowed``: the one that covers what these leave open, ``used``: what
    the covariance holds.
    """

    stated: float | None
    likely: float
    allowed: float
    dof: int
    used: float

    @property
    def estimated(self) -> bool:
        """Whether the circle, not the statement, gives what is used."""
        return self.stated is None or self.used > self.stated


@dataclass(frozen=True, eq=False, slots=True)
class Placement:
    """Where a solution has the table's axis and the instrument in the machine frame.

    ``point`` (3,) m lies on the axis, ``direction`` (3,) is its unit vector, upwards.
    ``stations`` (m, 3) m are the places of an instrument that rides on the table, at the
    ``positions`` (m,) of the plan; none for a method that does not look for them.
    """

    point: Floats
    direction: Floats
    positions: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    stations: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def upwards(cls, point: Floats, direction: Floats, *stations: Any) -> Placement:
        """Return the placement with a ``direction`` of any length and sense, turned upwards."""
        unit = direction / np.linalg.norm(direction)
        return cls(point, unit if unit[2] >= 0.0 else -unit, *stations)

    def __post_init__(self) -> None:
        """Raise DataError for shapes that do not fit, and for a direction that is no unit."""
        rows = len(self.positions)
        shapes = {"point": (3,), "direction": (3,), "positions": (rows,), "stations": (rows, 3)}
        for name, wanted in shapes.items():
            found = np.shape(getattr(self, name))
            if found != wanted:
                raise DataError(f"placement.{name} has shape {found}, expected {wanted}")
        if not np.isclose(np.linalg.norm(self.direction), 1.0) or self.direction[2] < 0.0:
            raise DataError("placement.direction: expected a unit vector that points upwards")

    def distance(self, place: Floats) -> float:
        """Return how far (m) a ``place`` (3,) is from the axis."""
        return float(np.linalg.norm(np.cross(place - self.point, self.direction)))


ALONG: Final = {"A": 0, "B": 1, "C": 2}
"""The direction that a rotary axis is nominally parallel to."""


@dataclass(frozen=True, eq=False, slots=True)
class AxisLine:
    """The average line of a rotary axis (ISO 230-7), less its nominal one; machine's coordinates.

    ``names`` (4,) after ISO 230-1: two places (m), then two small turns (rad), as XOC, YOC, AOC,
    BOC; ``value`` and ``std`` (4,) in their order, ``covariance`` (4, 4). ``origin`` (3,), m, is a
    nominal point: the places hold at its plane. All with the other rotary axes at zero. ``sense``
    is 1 if it turns the work counter-clockwise about :attr:`direction` for growing angles, -1 if
    clockwise, 0 if that is not known, as of results of before.
    """

    names: tuple[str, ...]
    value: Floats
    std: Floats
    covariance: Floats
    origin: Floats
    sense: int = 0

    def __post_init__(self) -> None:
        """Raise DataError for names that are no places and turns, and shapes that do not fit."""
        if not re.fullmatch(r"[XYZ]O([ABC]) [XYZ]O\1 [ABC]O\1 [ABC]O\1", " ".join(self.names)):
            raise DataError(
                f"axes: the names {', '.join(self.names)}: expected two places and two turns of "
                "an axis, as XOC, YOC, AOC, BOC"
            )
        if self.sense not in (-1, 0, 1):
            raise DataError(f"axes: sense is {self.sense}, expected 1, -1, or 0 if not known")
        shapes = {"value": (4,), "std": (4,), "covariance": (4, 4), "origin": (3,)}
        for name, wanted in shapes.items():
            found = np.shape(getattr(self, name))
            if found != wanted:
                raise DataError(f"axes: {name} has shape {found}, expected {wanted}")

    @property
    def letter(self) -> str:
        """Which axis it is: A, B or C."""
        return self.names[0][-1]

    @property
    def point(self) -> Floats:
        """A point (3,) of the measured line, m."""
        found: Floats = self.origin.copy()
        found[["XYZ".index(name[0]) for name in self.names[:2]]] += self.value[:2]
        return found

    @property
    def direction(self) -> Floats:
        """The measured direction (3,), at a length of about 1."""
        turn = np.zeros(3)
        turn[["ABC".index(name[0]) for name in self.names[2:]]] = self.value[2:]
        along = np.eye(3)[ALONG[self.letter]]
        return np.asarray(along + np.cross(turn, along))


@dataclass(frozen=True, eq=False, slots=True)
class Directions:
    """A deviation for approaches from either side, at the ``angles`` (k,) rad that have both.

    ``forward`` (k,) with increasing and ``reverse`` (k,) with decreasing angle count from the same
    zero as the deviations of the result, which are their mean. ``spread`` of 2 k values is the
    covariance of both together, forward first, as it is kept. Raises DataError when the shapes
    do not fit, or for NaN.
    """

    angles: Floats
    forward: Floats
    reverse: Floats
    spread: Spread

    def __post_init__(self) -> None:
        for name in ("forward", "reverse"):
            _require_numbers(f"the direction {name}", self.angles, getattr(self, name))
        wanted, found = (2 * len(self.angles),) * 2, (len(self.spread),) * 2
        if isinstance(self.spread, np.ndarray):
            found = np.shape(self.spread)
        if found != wanted or not np.all(np.isfinite(variances_of(self.spread))):
            raise DataError(
                f"the covariance of both directions has shape {found} or is not finite, expected "
                f"{wanted} finite numbers: forward, then reverse, at {len(self.angles)} angles"
            )

    @property
    def covariance(self) -> Floats:
        """That of both together, written out."""
        return written(self.spread)

    @property
    def reversal(self) -> Floats:
        """B_i of ISO 230-2 (k,): forward - reverse."""
        return self.forward - self.reverse

    @property
    def reversal_std(self) -> Floats:
        """The standard uncertainties (k,) of the reversal, from the joint covariance."""
        k = np.arange(len(self.angles))
        return np.sqrt(difference_variance(self.spread, k + len(k), k))


@dataclass(frozen=True, eq=False, slots=True)
class FreeDirection:
    """One number t that the data leave open: deviations are known up to t times ``columns``.

    ``columns`` maps components to (n,) arrays over the angles of the result; their effect on the
    mean of a curve does not matter, since no method knows the mean. ``name`` says what the offset
    lies between, such as "the odd and even table positions".
    """

    name: Phrase
    columns: Mapping[str, Floats]


@dataclass(frozen=True, eq=False, slots=True)
class Zeros:
    """What deviations count from, and which offsets no observation determines.

    ``counts_from`` is one of COUNTS_FROM. No method knows the zero of a whole curve, so it is not
    among the ``free`` directions. A result with ``free`` directions is never ok, since its
    uncertainties hold only within each part; ``within`` is the verdict there.
    """

    counts_from: str = UNKNOWN
    free: tuple[FreeDirection, ...] = ()
    within: Verdict = "ok"

    def __post_init__(self) -> None:
        if self.counts_from not in COUNTS_FROM:
            raise DataError(
                f"counts_from {self.counts_from!r}: expected one of {', '.join(COUNTS_FROM)}"
            )

    def of(self, component: str, n: int) -> Floats:
        """Return the columns (n, q) of one component, zeros for directions without it."""
        columns = [d.columns.get(component, np.zeros(n)) for d in self.free]
        return np.column_stack(columns) if columns else np.zeros((n, 0))

    def mapped(self, matrix: Any) -> Zeros:
        """Return the same for deviations that are ``matrix`` (m, n) times the present ones."""
        moved = (
            FreeDirection(d.name, {c: matrix @ column for c, column in d.columns.items()})
            for d in self.free
        )
        return replace(self, free=tuple(moved))

    def describe(self, components: Iterable[str] = COMPONENTS) -> Phrase:
        """Return a clause for each open offset of ``components``."""
        touched: dict[Phrase, set[str]] = {}
        for direction in self.free:
            if found := set(components) & direction.columns.keys():
                touched.setdefault(direction.name, set()).update(found)
        clause = noted("the offset between {0} is not measured ({1})")
        names = [", ".join(c for c in COMPONENTS if c in found) for found in touched.values()]
        return join_texts([phrase(clause, *each) for each in zip(touched, names, strict=True)])


@dataclass(frozen=True)
class Result:
    """Deviations of a rotary table with their uncertainties, and how far to trust them.

    ``angles`` (n,) are the commanded table angles in radians. ``deviations``, ``std`` map ISO
    230-1 names to (n,) arrays, ``covariance`` to (n, n) arrays. ``adjacent_deviations`` (n - 1,)
    are the deviations of the steps between neighbouring angles, in radians. A covariance that is
    kept as few numbers (:mod:`.compact`) is written out when it is asked for. ``sigma0`` is
    the a posteriori standard deviation of unit weight; 1 means that the stated noise fits.
    ``details`` are for people: nothing but the figures of a method reads them. ``protections``
    say what was done about each effect that could spoil the result; empty when not stated.
    ``directions`` maps components measured from both sides to their values from each side;
    ``deviations`` then holds the mean. ``measured_on`` is the compensation table in force
    meanwhile: the hash of the controller's files, "none" or "unknown". ``circumstances`` say who
    measured what, when and how warm it was; a method leaves them to those who call it. ``zeros``
    say what the deviations count from, and which offsets are open. ``raw_data``: the observations
    that it rests on, so that they are not counted twice. ``budget`` splits the uncertainty of ECC:
    standard uncertainties (n,) by source, which add in squares; empty if only the whole is known.
    ``placement`` and ``error_motion`` are None for a method that does not find them. ``axes``:
    where the table's axis stands and the one that tilts it, of a method that measures this.

    >>> import rotcal_ros as rc
    >>> result = rc.read_result("examples/data/result_ball_plate.json")
    >>> result.verdict, result.angles.shape, result.deviations["ECC"].shape
    ('ok', (12,), (12,))
    """

    method: str
    angles: Floats
    deviations: Mapping[str, Floats]
    std: Mapping[str, Floats]
    covariance: Mapping[str, Floats]
    sigma0: float
    dof: int
    n_observations: int
    rejected: tuple[Rejection, ...] = ()
    verdict: Verdict = "ok"
    warnings: tuple[Phrase, ...] = ()
    adjacent_deviations: Floats | None = None
    adjacent_std: Floats | None = None
    residuals: Residuals | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    runs: RepeatedRuns | None = None
    protections: tuple[Protection, ...] = ()
    directions: Mapping[str, Directions] = field(default_factory=dict)
    measured_on: str = UNKNOWN
    circumstances: Circumstances = field(default_factory=Circumstances)
    zeros: Zeros = field(default_factory=Zeros)
    raw_data: RawData = field(default_factory=RawData)
    budget: Mapping[str, Floats] = field(default_factory=dict)
    placement: Placement | None = None
    error_motion: ErrorMotion | None = None
    axes: tuple[AxisLine, ...] = ()

    @property
    def simulated(self) -> bool:
        """Whether a simulation was measured instead of a table."""
        return self.circumstances.simulated

    @property
    def unprotected(self) -> tuple[Effect, ...]:
        """Effects that may have spoiled the result without a trace in the data."""
        return unprotected(self.protections)

    @property
    def verdict_words(self) -> Phrase:
        """The verdict for people, the first of the two lines that belong together."""
        verdict = phrase(self.verdict)
        if self.simulated:
            verdict = phrase("{0} (SIMULATED)", verdict)
        if self.zeros.free:
            verdict = phrase("{0}, {1}", verdict, self.zeros.describe())
        return verdict

    @property
    def not_tested(self) -> Phrase:
        """What the verdict does not cover; empty where it covers everything."""
        if not self.protections:
            if self.dof == 0:
                return phrase("anything (nothing checked the values)")
            return phrase("drift and similar effects (the method makes no statement)")
        return join_texts([phrase(effect) for effect in self.unprotected], ", ")

    @property
    def verdict_line(self) -> Phrase:
        """Both lines as one text: the verdict, never without what it does not cover."""
        words, missing = self.verdict_words, self.not_tested
        return phrase(BOTH_LINES, words, missing) if missing else words

    @property
    def verdict_within(self) -> Verdict:
        """The verdict within each part that has its own zero, else the verdict itself."""
        return self.zeros.within if self.zeros.free else self.verdict

    def as_suspect(self) -> Result:
        """Return the result suspect at best, within its parts too."""
        within, verdict = _at_best_suspect(self.zeros.within), _at_best_suspect(self.verdict)
        return replace(self, verdict=verdict, zeros=replace(self.zeros, within=within))

    def protected(self, by: Protection) -> Result:
        """Return the result with ``by`` in place of what it says of that effect."""
        every = tuple(by if p.effect == by.effect else p for p in self.protections)
        return replace(self, protections=every)

    def counted_from(self, counts_from: str, free: Iterable[FreeDirection] = ()) -> Result:
        """Return the result with its :class:`Zeros`: suspect at best where some are open."""
        zeros = Zeros(counts_from, tuple(free), self.verdict)
        verdict = _at_best_suspect(self.verdict) if zeros.free else self.verdict
        return replace(self, verdict=verdict, zeros=zeros)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the deviations that were measured, in the order of COMPONENTS."""
        return tuple(name for name in COMPONENTS if name in self.deviations)

    @property
    def all_details(self) -> Mapping[str, Any]:
        """The details with budget, error motion and repeated runs among them, as in a file."""
        details = dict(self.details)
        if self.budget:
            details[BUDGET] = self.budget
        if self.error_motion is not None:
            details[ERROR_MOTION] = asdict(self.error_motion)
        if self.runs is not None:
            runs = asdict(self.runs).items()
            details[RUNS] = {name: value for name, value in runs if value is not None}
        return details

    def __post_init__(self) -> None:
        """Refuse deviations and uncertainties that are not one number per angle.

        Raises DataError: a component that was not measured is absent, never NaN.
        """
        for what, columns in (("", self.deviations), ("std of ", self.std)):
            for name, values in columns.items():
                _require_numbers(f"{self.method}: {what}{name}", self.angles, values)
        for direction in self.zeros.free:
            for name, values in direction.columns.items():
                _require_numbers(f"{self.method}: free direction of {name}", self.angles, values)
        if self.zeros.free and self.verdict == "ok":
            raise DataError(
                f"{self.method}: the verdict is ok although {self.zeros.describe()}: expected "
                "suspect, nothing bounds the error of such an offset"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form described in docs/result_json.md (SI, plain types)."""
        data: dict[str, Any] = {
            "schema": SCHEMA,
            "method": self.method,
            "simulated": self.simulated,
            "circumstances": self.circumstances.to_dict(),
            "angles_rad": self.angles,
            "deviations": self.deviations,
            "std": self.std,
        }
        data |= plain_covariances(kept(self.covariance))
        if self.adjacent_deviations is not None:
            data["adjacent_deviations_rad"] = self.adjacent_deviations
        if self.adjacent_std is not None:
            data["adjacent_std_rad"] = self.adjacent_std
        if self.directions:
            data["directions"] = {
                name: {"angles_rad": own.angles, "forward": own.forward, "reverse": own.reverse}
                | plain_covariance(own.spread)
                for name, own in self.directions.items()
            }
        data |= self._places()
        if self.zeros.counts_from != UNKNOWN:
            data["zeros"] = json_fields(self.zeros) | {
                "free": [json_fields(direction) for direction in self.zeros.free]
            }
        if self.measured_on != UNKNOWN:
            data["measured_on"] = self.measured_on
        data |= {
            "sigma0": self.sigma0,
            "dof": self.dof,
            "n_observations": self.n_observations,
            "n_rejected": len(self.rejected),
            "rejected": [{"index": r.index, "why": r.why} for r in self.rejected],
            "verdict": self.verdict,
            "verdict_line": self.verdict_line,
            "not_protected": list(self.unprotected),
            "warnings": list(self.warnings),
            "protections": [json_fields(p) for p in self.protections],
            "codes": codes_of(self._texts()),
            "details": self.all_details,
        }
        if self.raw_data.hashes:
            data["raw_data"] = self.raw_data.to_dict()
        if self.residuals is not None:
            columns = json_fields(self.residuals)
            if self.residuals.unit == "m":  # as it is where nothing is said
                del columns["unit"]
            data["residuals"] = {FILE_NAMES.get(name, name): c for name, c in columns.items()}
        return {name: json_value(value) for name, value in data.items()}

    def _texts(self) -> Any:
        """Return all that has texts for people."""
        of_rows = [[r.why for r in self.rejected], [p.why for p in self.protections]]
        names = [free.name for free in self.zeros.free]
        return [self.warnings, of_rows, names, self.circumstances.refraction, self.details]

    def _places(self) -> dict[str, Any]:
        """Return where axes and instrument stand, as far as that was measured."""
        data: dict[str, Any] = {}
        if self.placement is not None:
            data["placement"] = json_fields(self.placement)
        if self.axes:
            data["axes"] = [json_fields(axis) for axis in self.axes]
        return data

    def to_json(self) -> str:
        """Return :meth:`to_dict` as JSON; every float round-trips to the last bit."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False)

    def __repr__(self) -> str:
        """Return the verdict and the size of each deviation, in a line each."""
        first, *rest = self.summary
        return "\n".join([f"<Result: {first}", *(f"  {line}" for line in rest)]) + ">"

    def _repr_html_(self) -> str:
        """Return the same for a notebook."""
        first, *rest = (escape(line) for line in self.summary)
        return f"<b>{first}</b><br>" + "<br>".join(rest)

    @property
    def summary(self) -> list[str]:
        """The verdict, what was measured, and the size of each deviation, for people."""
        low, high = self.angles.min() / DEGREE, self.angles.max() / DEGREE
        lines = [
            f"{self.method}, {self.verdict_line}",
            f"{len(self.angles)} angles from {low:g} to {high:g} deg, {self.n_observations} "
            f"observations, {len(self.rejected)} rejected, sigma0 {self.sigma0:.3g}",
        ]
        for name in self.components:
            factor, unit = unit_of(name)
            values = self.deviations[name] / factor
            line = f"{name} from {values.min():.4g} to {values.max():.4g} {unit}"
            if self.verdict == "ok":
                band = COVERAGE_FACTOR * float(self.std[name].max()) / factor
                line += f", U (k = 2) at most {band:.2g} {unit}"
            lines.append(line)
        more = f"{len(self.warnings)} warnings, the first: " if len(self.warnings) > 1 else ""
        return [*lines, *(f"{more}{text}" for text in self.warnings[:1])]

    def plot(self, truth: Mapping[str, Any] | None = None) -> Any:
        """Return the deviations over the angle with U (k = 2) as a figure of Matplotlib.

        It has the look of the report. ``truth`` is the content of the truth.json of a simulation.

        >>> import rotcal_ros as rc
        >>> figure = rc.read_result("examples/data/result_tracer.json").plot()
        >>> figure.axes[0].get_ylabel()
        'ECC / arcsec'
        """
        return plugins.load(plugins.FIGURES, "plot", "figure")(self, truth)

    def to_xarray(self) -> Any:
        """Return an xarray Dataset over ``angle`` (rad), and ``again``, the same once more.

        ``deviation`` and ``std`` by ``component`` and ``angle``, ``covariance`` by both angles; m
        and rad, NaN where a covariance is not known. Only this needs xarray; without it
        ImportError says so.
        """
        try:
            xarray = import_module("xarray")
        except ImportError as error:
            raise ImportError("Result.to_xarray() needs xarray: pip install xarray") from error
        names = list(self.components)
        two, three = ("component", "angle"), ("component", "angle", "again")
        unknown = np.full(2 * (len(self.angles),), np.nan)
        covariance = [self.covariance.get(name, unknown) for name in names]
        variables = {
            "deviation": (two, np.array([self.deviations[name] for name in names])),
            "std": (two, np.array([self.std[name] for name in names])),
            "covariance": (three, np.array(covariance)),
        }
        places = {"component": names, "angle": self.angles, "again": self.angles}
        attributes = {"method": self.method, "verdict": self.verdict, "units": "m, rad"}
        return xarray.Dataset(variables, places, attributes)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame: a row for each angle, SI, ``EXC`` with ``EXC_std`` and so on.

        A component whose zeros are open has ``EXC_free_0`` ... too, the free directions: its
        values are known up to any multiple of these, and its std holds where they are equal.

        Only this needs pandas; without it ImportError says so.
        """
        columns = {"angle_rad": self.angles}
        for name, values in self.deviations.items():
            columns |= {name: values, f"{name}_std": self.std[name]}
            touching = (d.columns[name] for d in self.zeros.free if name in d.columns)
            columns |= {f"{name}_free_{k}": column for k, column in enumerate(touching)}
        return dataframe(columns)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Result:
        """Rebuild a result from :meth:`to_dict`.

        Raises DataError, with the entry, when it is none or does not fit together.
        """
        if not isinstance(data, Mapping) or data.get("schema") != SCHEMA:
            raise DataError(
                f"not a rotcal result of schema {SCHEMA}: no matching 'schema' entry; {_AGAIN}"
            )
        try:
            return _result(data)
        except KeyError as error:
            raise DataError(
                f"no whole rotcal result: the entry {error} is missing; {_AGAIN}"
            ) from error
        except (ArithmeticError, AttributeError, ConfigurationError, TypeError, ValueError) as e:
            raise DataError(f"damaged rotcal result: {e}; {_AGAIN}") from e


def _at_best_suspect(verdict: Verdict) -> Verdict:
    return "suspect" if verdict == "ok" else verdict


def _require_numbers(name: str, angles: Floats, values: Floats) -> None:
    """Raise DataError unless there is one finite value for every angle (rad)."""
    if np.shape(values) != np.shape(angles):
        raise DataError(
            f"{name} has shape {np.shape(values)}, expected one number for each of the "
            f"{len(angles)} angles"
        )
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        row = int(bad[0])
        raise DataError(
            f"{name} is {values[row]} at {angles[row] / DEGREE:g} deg (row {row}): expected a "
            "finite number; a component that was not measured is left out"
        )


def json_fields(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass as plain values for JSON."""
    return {field.name: json_value(getattr(record, field.name)) for field in fields(record)}


def json_value(value: Any) -> Any:
    """Return arrays, mappings and tuples as plain values, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        items = value.tolist()
        return items if np.all(np.isfinite(value)) else json_value(items)
    if isinstance(value, np.ndarray | np.generic):
        return json_value(value.tolist())
    if isinstance(value, float) and not isfinite(value):
        return None  # JSON has neither; reading null back into an array gives NaN
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    return value


_WHOLE: Final[Mapping[str, type]] = {
    "table_position": np.int64,
    "target": np.int64,
    "used": np.bool_,
}
"""Columns of the residuals that are not floats."""
_TEXTS: Final = ("rejected", "warnings", "protections", "details", "zeros", "circumstances")


@dataclass(frozen=True)
class _Plain:
    """The entries of a file that are not arrays."""

    method: str
    sigma0: float
    dof: int
    n_observations: int
    rejected: tuple[Rejection, ...]
    verdict: str
    warnings: tuple[Phrase, ...]
    details: Mapping[str, Any]
    protections: tuple[Protection, ...]
    measured_on: str = UNKNOWN


def _result(data: Mapping[str, Any]) -> Result:
    for each in fields(_Plain)[:-1]:
        data[each.name]
    data = {**data, **with_codes({n: data[n] for n in _TEXTS if n in data}, data.get("codes"))}
    plain = record(_Plain, {f.name: data[f.name] for f in fields(_Plain) if f.name in data})
    if plain.verdict not in get_args(Verdict):
        raise ValueError(f"verdict: {plain.verdict!r} is none of {', '.join(get_args(Verdict))}")
    angles = finite_column(data["angles_rad"], "angles_rad")
    n, runs = len(angles), _runs(plain.details.get(RUNS))
    budget = _budget(plain.details.get(BUDGET), n)
    error_motion = _error_motion(plain.details.get(ERROR_MOTION))
    typed = {RUNS: runs, BUDGET: budget, ERROR_MOTION: error_motion}
    deviations = finite_columns(data["deviations"], "deviations", (n,))
    std = finite_columns(data["std"], "std", (n,))
    if n == 0 or not std.keys() >= deviations.keys():
        raise ValueError("expected angles, and a std for each of the deviations")
    if any(np.any(column < 0.0) for column in std.values()):
        raise ValueError("std: expected no negative number")
    return Result(
        method=plain.method,
        angles=angles,
        deviations=deviations,
        std=std,
        covariance=covariances_from(data, n),
        sigma0=plain.sigma0,
        dof=plain.dof,
        n_observations=plain.n_observations,
        rejected=plain.rejected,
        verdict=data["verdict"],
        warnings=plain.warnings,
        protections=ordered(plain.protections),
        adjacent_deviations=_optional(data, "adjacent_deviations_rad", (n - 1,)),
        adjacent_std=_optional(data, "adjacent_std_rad", (n - 1,)),
        residuals=None if data.get("residuals") is None else _residuals(data["residuals"]),
        details={name: value for name, value in plain.details.items() if not typed.get(name)},
        runs=runs,
        budget=budget,
        placement=None if data.get("placement") is None else _placement(data["placement"]),
        error_motion=error_motion,
        axes=tuple(map(_axis, data.get("axes", ()))),
        directions=_directions(data.get("directions", {})),
        measured_on=check_in_force(plain.measured_on),
        circumstances=Circumstances.from_dict(data["circumstances"]),
        raw_data=RawData.from_dict(data["raw_data"], n) if "raw_data" in data else RawData(),
        zeros=_zeros(data.get("zeros", {}), n),
    )


def _zeros(data: Mapping[str, Any], n: int) -> Zeros:
    if data and data["within"] not in get_args(Verdict):
        raise ValueError(f"zeros.within: {data['within']!r:.60} is no verdict")
    free = [
        FreeDirection(phrase(str(d["name"])), finite_columns(d["columns"], "zeros.free", (n,)))
        for d in data.get("free", ())
    ]
    counts_from = str(data.get("counts_from", UNKNOWN))
    return Zeros(counts_from, tuple(free), data.get("within", "ok"))


def _runs(data: Any) -> RepeatedRuns | None:
    if not isinstance(data, Mapping) or "targets" not in data:
        return None
    targets = finite_column(data["targets"], "runs.targets")
    sides = {name: _side(data.get(name), len(targets), name) for name in ("forward", "reverse")}
    shapes = {np.shape(side) for side in sides.values() if side is not None}
    if len(shapes) > 1:
        raise ValueError(f"runs: forward and reverse have different shapes {sorted(shapes)}")
    repeatability = data.get("repeatability_std")
    if not isinstance(repeatability, float | int | None):
        raise ValueError(f"runs.repeatability_std: expected a number, found {repeatability!r:.60}")
    return RepeatedRuns(targets=targets, **sides, repeatability_std=repeatability)


def _budget(data: Any, n: int) -> dict[str, Floats]:
    """Return the shares by source; empty if the details have something else of that name."""
    if not isinstance(data, Mapping) or any(np.shape(share) != (n,) for share in data.values()):
        return {}
    return {source: floats(share, f"budget.{source}") for source, share in data.items()}


def _error_motion(data: Any) -> ErrorMotion | None:
    """Return the error motion; None if the details have something else of that name."""
    names = {field.name for field in fields(ErrorMotion)}
    if not isinstance(data, Mapping) or data.keys() != names:
        return None
    return record(ErrorMotion, dict(data), f"details.{ERROR_MOTION}")


def _placement(data: Mapping[str, Any]) -> Placement:
    positions = finite_column(data["positions"], "placement.positions")
    stations = floats(data["stations"], "placement.stations")
    if not np.all(np.isfinite(stations)) or np.any(positions % 1.0):
        raise ValueError("placement: expected finite stations, and whole numbers as positions")
    return Placement(
        finite_column(data["point"], "placement.point"),
        finite_column(data["direction"], "placement.direction"),
        positions.astype(np.int64),
        stations if stations.size else np.zeros((0, 3)),
    )


def _axis(data: Mapping[str, Any]) -> AxisLine:
    covariance = floats(data["covariance"], "axes.covariance")
    if not np.all(np.isfinite(covariance)):
        raise ValueError("axes.covariance: expected finite numbers")
    value, std, origin = (finite_column(data[n], f"axes.{n}") for n in ("value", "std", "origin"))
    names, sense = tuple(map(str, data["names"])), data.get("sense", 0)
    return AxisLine(names, value, std, covariance, origin, sense)


def _side(values: Any, targets: int, name: str) -> Floats | None:
    if values is None:
        return None
    side = floats(values, f"runs.{name}")
    if side.ndim != 2 or len(side) != targets:
        raise ValueError(f"runs.{name}: expected a row for each of {targets} targets")
    return side


def _directions(data: Any) -> dict[str, Directions]:
    found = {}
    for name, both in dict(data).items():
        where = f"directions.{name}"
        keys = ("angles_rad", "forward", "reverse")
        angles, up, down = (floats(both[key], f"{where}.{key}") for key in keys)
        found[name] = Directions(angles, up, down, spread_from(both, 2 * len(angles), where))
    return found


def _residuals(data: Mapping[str, Any]) -> Residuals:
    optional = ("std", "coordinates", "unit")
    names = [field.name for field in fields(Residuals) if field.name not in optional]
    columns: dict[str, Any] = {}
    for name in names:
        key = FILE_NAMES.get(name, name)
        whole = _WHOLE.get(name)
        columns[name] = (
            floats(data[key], f"residuals.{key}")
            if whole is None
            else np.asarray(data[key], whole)
        )
    shape = np.shape(columns["residual"])
    std, coordinates = _optional(data, "std", shape), data.get("coordinates", 1)
    if len(shape) != 1 or any(np.shape(column) != shape for column in columns.values()):
        raise ValueError("residuals: expected columns of one length")
    if coordinates not in (1, 3):
        raise ValueError(f"residuals.coordinates: expected 1 or 3, found {coordinates!r:.60}")
    unit = data.get("unit", "m")
    if unit not in ("m", "rad"):
        raise ValueError(f"residuals.unit: expected m or rad, found {unit!r:.60}")
    return Residuals(**columns, std=std, coordinates=coordinates, unit=unit)


def _optional(data: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Floats | None:
    values = data.get(name)
    if values is None:
        return None
    column = floats(values, name)
    if column.shape != shape:
        raise ValueError(f"{name}: expected numbers of the shape {shape}")
    return column
