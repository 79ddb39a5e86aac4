"""The observations that a result rests on, and what an error of each does to its deviations.

The same data count once, however often they are evaluated: two results that share observations are
not independent. Shared observations are found by the time of measurement or, in tables without
time, by a hash of each value; their effect on both results follows from their influences, if these
are linear.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MOST_INFLUENCES: Final = 1_500_000
"""Most numbers in the influences of a result (8 MB of its file); with more, none are kept."""
BY_CHANCE: Final = 0.2
"""Share of coarsely read values without time that two measurements may share by chance."""
_DIGITS: Final = 16
_STEP: Final = 1e-10
"""Values are rounded to this, m or rad: no instrument resolves it, and arithmetic changes less."""


def _none() -> Ints:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Influence:
    """What errors of one standard uncertainty each do to the deviations, to first order.

    ``rows`` (n,): the observations, of which each has ``coordinates`` values. ``causes`` (q,) name
    the errors that observations of one measurement have in common, such as those of a target's
    coordinates. ``deviations`` maps ISO 230-1 names to (m, n * coordinates + q), m or rad.
    """

    rows: Ints
    coordinates: int
    deviations: Mapping[str, Floats]
    causes: tuple[str, ...] = ()

    @property
    def kept(self) -> bool:
        """Whether it is small enough to be kept with a result."""
        return sum(matrix.size for matrix in self.deviations.values()) <= MOST_INFLUENCES

    def with_row_numbers(self, number: Mapping[int, int]) -> Influence:
        """Return the same influences for renumbered observations."""
        rows = np.array([number[row] for row in self.rows.tolist()], dtype=np.int64)
        return replace(self, rows=rows)

    def transformed(self, to: Floats | csr_array) -> Influence:
        """Return the influences on ``to`` (k, m) times the deviations (m,)."""
        return replace(self, deviations={c: to @ own for c, own in self.deviations.items()})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values: matrices as base64 of little-endian 32-bit floats, row by row."""
        return {
            "rows": self.rows.tolist(),
            "coordinates": self.coordinates,
            "causes": list(self.causes),
            "deviations": {c: _packed(matrix) for c, matrix in self.deviations.items()},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], n: int, m: int) -> Influence:
        """Return what :meth:`to_dict` wrote, of ``n`` observations on ``m`` angles; ValueError."""
        rows, causes = _whole(data["rows"], "rows"), tuple(map(str, data["causes"]))
        coordinates = data["coordinates"]
        if coordinates not in (1, 3) or np.any((rows < 0) | (rows >= n)):
            raise ValueError("raw_data.influence: it does not belong to these observations")
        width = len(rows) * coordinates + len(causes)
        deviations = {str(c): _unpacked(v, m, width) for c, v in dict(data["deviations"]).items()}
        return cls(rows, int(coordinates), deviations, causes)


@dataclass(frozen=True, eq=False)
class RawData:
    """The observations of a result: ``hashes`` (n,), and when each was ``begun`` and ``ended``.

    Times are nanoseconds since 1970, empty if not all observations are dated. ``influence`` is
    None if the method states none, or it is too large.
    """

    hashes: tuple[str, ...] = ()
    begun_ns: Ints = field(default_factory=_none)
    ended_ns: Ints = field(default_factory=_none)
    influence: Influence | None = None

    @property
    def has_times(self) -> bool:
        """Whether the observations have times."""
        return len(self.begun_ns) > 0

    @classmethod
    def of(cls, observations: Sequence[Observation], dated_from_ns: int) -> RawData:
        """Return the data of captured observations.

        A window before ``dated_from_ns`` is not a date.
        """
        hashes = tuple(hash_of(o.mean, int(o.kind)) for o in observations)
        begun = np.array([o.window_start_ns for o in observations], dtype=np.int64)
        ended = np.array([o.window_end_ns for o in observations], dtype=np.int64)
        if not len(begun) or begun.min() < dated_from_ns:
            return cls(hashes)
        return cls(hashes, begun, ended)

    def transformed(self, to: Floats | csr_array) -> RawData:
        """Return the raw data of a result that is ``to`` (k, m) times this one."""
        found = self.influence
        return self if found is None else replace(self, influence=found.transformed(to))

    def of_curve(self, component: str) -> RawData:
        """Return the same with the influences on one component alone; None if it has none."""
        found = self.influence
        if found is not None and component in found.deviations:
            found = replace(found, deviations={component: found.deviations[component]})
            return replace(self, influence=found)
        return replace(self, influence=None)

    def with_row_numbers(self, number: Mapping[int, int]) -> RawData:
        """Return the same with other numbers of the observations that have an influence."""
        found = self.influence
        return self if found is None else replace(self, influence=found.with_row_numbers(number))

    def joined(self, other: RawData) -> RawData:
        """Return all observations of both; their influences are no longer known."""
        mine = set(self.hashes)
        more = np.array([h not in mine for h in other.hashes], dtype=np.bool_)
        hashes = self.hashes + tuple(np.array(other.hashes, dtype=object)[more])
        if not (self.has_times and other.has_times):
            return RawData(hashes if self.hashes else other.hashes)
        begun = np.append(self.begun_ns, other.begun_ns[more])
        return RawData(hashes, begun, np.append(self.ended_ns, other.ended_ns[more]))

    def common_observations(self, other: RawData) -> tuple[Ints, Ints]:
        """Return which observations are the same: numbers here and there (k,).

        They are those whose windows overlap; without dates those of equal values, unless they are
        so few that coarsely read values may agree by chance.
        """
        if self.has_times and other.has_times:
            return self._at_the_same_time(other)
        places: dict[str, list[int]] = {}
        for j, own in enumerate(other.hashes):
            places.setdefault(own, []).append(j)
        pairs = [(i, places[own].pop()) for i, own in enumerate(self.hashes) if places.get(own)]
        fewer = min(len(self.hashes), len(other.hashes))
        if len(pairs) <= BY_CHANCE * fewer:
            pairs = []
        here, there = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        return here, there

    def _at_the_same_time(self, other: RawData) -> tuple[Ints, Ints]:
        order = np.argsort(other.begun_ns, kind="stable")
        begun = other.begun_ns[order]
        # The last window there that begins before this one ends; they are one after the other.
        last = np.searchsorted(begun, self.ended_ns, side="right") - 1
        there = order[np.maximum(last, 0)]
        same = (last >= 0) & (other.ended_ns[there] >= self.begun_ns)
        return np.flatnonzero(same), there[same]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file."""
        data: dict[str, Any] = {"sha256": list(self.hashes)}
        if self.has_times:
            data |= {"begun_ns": self.begun_ns.tolist(), "ended_ns": self.ended_ns.tolist()}
        if self.influence is not None and self.influence.kept:
            data["influence"] = self.influence.to_dict()
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], m: int) -> RawData:
        """Return what :meth:`to_dict` wrote, of a result at ``m`` angles; raises ValueError."""
        hashes = data["sha256"]
        if not isinstance(hashes, list) or not all(isinstance(own, str) for own in hashes):
            raise ValueError("raw_data.sha256: expected a list of texts")
        begun, ended = (_whole(data.get(name, []), name) for name in ("begun_ns", "ended_ns"))
        if len(begun) not in (0, len(hashes)) or len(begun) != len(ended):
            raise ValueError("raw_data: expected a time for each of the observations, or none")
        found = cls(tuple(hashes), begun, ended)
        if "influence" not in data:
            return found
        return replace(found, influence=Influence.from_dict(data["influence"], len(hashes), m))


def hash_of(values: Sequence[float], kind: int) -> str:
    """Return 16 hexadecimal digits for measured ``values`` (SI) of a kind.

    Angles and numbers of targets, stations and nests are not part of it: they come from a plan and
    its order, and a table of some of the data has its own.
    """
    whole = [kind, *(round(value / _STEP) for value in values)]
    return sha256(f"{whole}".encode()).hexdigest()[:_DIGITS]


def _packed(matrix: Floats) -> str:
    return base64.b64encode(np.ascontiguousarray(matrix, dtype="<f4").tobytes()).decode("ascii")


def _unpacked(text: Any, m: int, width: int) -> Floats:
    try:
        numbers = np.frombuffer(base64.b64decode(text, validate=True), dtype="<f4")
    except (TypeError, ValueError, binascii.Error) as error:
        raise ValueError(f"raw_data.influence: no numbers: {error}") from error
    if numbers.size != m * width or not np.all(np.isfinite(numbers)):
        raise ValueError(f"raw_data.influence: expected {m} x {width} finite numbers")
    return numbers.reshape(m, width).astype(np.float64)


def _whole(values: Any, where: str) -> Ints:
    if not isinstance(values, list) or not all(type(value) is int for value in values):
        raise ValueError(f"raw_data.{where}: expected a list of whole numbers")
    try:
        return np.array(values, dtype=np.int64).reshape(-1)
    except OverflowError as error:
        raise ValueError(f"raw_data.{where}: {error}") from error
