"""Covariances of many values by few numbers: what is own to a few of them, and what all share.

A matrix grows with the square of its angles. What a solution says of hundreds of angles is less:
every angle has errors of its own, neighbours share those of noise that lasts, and a few targets,
zeros and motions are common to all. So C = N N' + L S L': N (n, k) has few entries a row, L (n, r)
few columns, and S is a diagonal of signs; -1 is what something known beforehand takes off. That is
C itself, not an approximation of it.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.file_numbers import finite_columns, floats

if TYPE_CHECKING:  # it takes as long to load as most verbs take to run
    from scipy.sparse import csr_array

FULL: Final = 256
"""Values up to which a covariance is kept as a matrix (0.5 MB)."""
ROUNDED: Final = 1e-14
"""Share of the largest variance below which something in common is rounding."""
AT_ONCE: Final = 256
"""Rows that are written out at once."""
COMPACT: Final = "compact_covariance"
"""Where a file has covariances in this form."""
CONTRADICTS: Final = 1e-6
"""Share of the largest variance by which a covariance may exceed what the variances allow."""


@dataclass(frozen=True, eq=False, slots=True)
class CompactCovariance:
    """C = N N' + L S L' of n values: ``near`` N (n, k), ``common`` L (n, r), ``signs`` S (r,)."""

    near: csr_array
    common: Floats
    signs: Floats

    @classmethod
    def of(cls, near: csr_array, low: Floats, core: Floats) -> CompactCovariance:
        """Return N N' + ``low`` (n, q) ``core`` (q, q) times the transposed of low."""
        near.eliminate_zeros()
        basis, triangle = np.linalg.qr(low)
        size, ways = np.linalg.eigh(triangle @ core @ triangle.T)
        found = cls(near, basis @ (ways * np.sqrt(np.abs(size))), np.sign(size))
        kept = np.abs(size) > ROUNDED * found.variances.max(initial=0.0)
        return cls(near, found.common[:, kept], found.signs[kept])

    @classmethod
    def alone(cls, std: Floats) -> CompactCovariance:
        """Return that of independent values of ``std`` (n,)."""
        every = np.arange(len(std) + 1)
        return cls(_rows(std, every[:-1], every, len(std)), np.zeros((len(std), 0)), np.zeros(0))

    @classmethod
    def shared(cls, errors: Floats) -> CompactCovariance:
        """Return that of values which independent ``errors`` (n, p) spoil together."""
        none = np.zeros(0, dtype=np.int64)
        near = _rows(np.zeros(0), none, np.zeros(len(errors) + 1, dtype=np.int64), 0)
        return cls(near, errors, np.ones(errors.shape[1]))

    def __len__(self) -> int:
        """Return how many values it is of."""
        return len(self.common)

    @property
    def variances(self) -> Floats:
        """The diagonal (n,)."""
        own = np.asarray((self.near * self.near).sum(axis=1)).ravel()
        return np.maximum(own + self.common**2 @ self.signs, 0.0)

    def of_differences(self, first: int | Ints, last: int | Ints) -> Floats:
        """Return the variances (q,) of what values ``last`` (q,) are beyond ``first``."""
        first, last = np.atleast_1d(first), np.atleast_1d(last)
        apart = self.near[last] - self.near[first]
        own = np.asarray((apart * apart).sum(axis=1)).ravel()
        return np.maximum(own + (self.common[last] - self.common[first]) ** 2 @ self.signs, 0.0)

    def rows(self, which: slice) -> Floats:
        """Return some rows (q, n), written out."""
        found = (self.common[which] * self.signs) @ self.common.T
        found += (self.near[which] @ self.near.T).toarray()
        return np.asarray(found)

    def dense(self) -> Floats:
        """Return the whole matrix (n, n)."""
        found = np.empty((len(self), len(self)))
        for some in self._parts():
            found[some] = self.rows(some)
        return found

    def _parts(self) -> Iterator[slice]:
        return (slice(b, min(b + AT_ONCE, len(self))) for b in range(0, len(self), AT_ONCE))

    def plus(self, other: CompactCovariance) -> CompactCovariance:
        """Return that of the sums with independent values."""
        from scipy.sparse import hstack

        return CompactCovariance(
            hstack([self.near, other.near], format="csr"),
            np.hstack([self.common, other.common]),
            np.append(self.signs, other.signs),
        )

    def condensed(self) -> CompactCovariance:
        """Return the same in no more numbers than a triangle of the matrix has.

        Where many values share errors of hundreds of observations, ``near`` has more.
        """
        n = len(self)
        if self.near.nnz <= n * (n + 1) // 2:
            return self
        from scipy.linalg import qr
        from scipy.sparse import csr_array

        (root,) = qr(self.near.T.toarray(), mode="r", overwrite_a=True, check_finite=False)
        return CompactCovariance(csr_array(np.tril(root[:n].T)), self.common, self.signs)

    def scaled(self, by: Floats) -> CompactCovariance:
        """Return that of the values times ``by`` (n,)."""
        near = self.near.copy()
        near.data *= np.repeat(by, np.diff(near.indptr))
        return CompactCovariance(near, self.common * by[:, None], self.signs)

    def mapped(self, to: Floats | csr_array) -> CompactCovariance:
        """Return that of ``to`` (m, n) times the values."""
        from scipy.sparse import csr_array

        near, common = csr_array(csr_array(to) @ self.near), np.asarray(to @ self.common)
        near.eliminate_zeros()
        return CompactCovariance(near, common, self.signs)

    def part(self, which: slice | Ints) -> CompactCovariance:
        """Return that of some of the values."""
        return CompactCovariance(self.near[which], self.common[which], self.signs)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file: see docs/result_json.md."""
        used, column = np.unique(self.near.indices, return_inverse=True)
        return {
            "columns": len(used),
            "begin": _packed(self.near.indptr, "<i4"),
            "column": _packed(column, "<i4"),
            "value": _packed(self.near.data, "<f8"),
            "common": _packed(self.common, "<f8"),
            "signs": self.signs.tolist(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], n: int) -> CompactCovariance:
        """Return what :meth:`to_dict` wrote, of ``n`` values; ValueError for anything else."""
        begin, column = (_unpacked(data[name], "<i4") for name in ("begin", "column"))
        value, common = (_unpacked(data[name], "<f8") for name in ("value", "common"))
        signs, columns = np.array(data["signs"], dtype=np.float64), int(data["columns"])
        if columns > len(column):  # a product takes room for each, used or not
            raise ValueError(f"compact covariance: {columns} columns of {len(column)} values")
        ends = len(begin) == n + 1 and begin[0] == 0 and begin[-1] == len(column) == len(value)
        if not ends or np.any(np.diff(begin) < 0) or np.any((column < 0) | (column >= columns)):
            raise ValueError(f"compact covariance: no rows of {n} values")
        if signs.ndim != 1 or np.any(np.abs(signs) != 1.0) or common.size != n * len(signs):
            raise ValueError("compact covariance: expected signs 1 and -1, and a column for each")
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(common))):
            raise ValueError("compact covariance: expected finite numbers")
        found = cls(_rows(value, column, begin, columns), common.reshape(n, len(signs)), signs)
        found.check()
        return found

    def check(self) -> None:
        """Raise ValueError where it exceeds what its variances allow."""
        variances = self.variances
        for some in self._parts():
            require_allowed(COMPACT, self.rows(some), variances[some], variances)


Spread: TypeAlias = Floats | CompactCovariance
"""A covariance in the form in which it is kept."""


class Covariances(Mapping[str, Floats]):
    """Covariances by component, in the form in which they are ``kept``.

    One that is asked for is a matrix (n, n), written out if need be: of thousands of values that
    is much, so what needs less asks for the form that is kept.
    """

    def __init__(self, kept: Mapping[str, Spread]) -> None:
        self.kept = dict(kept)

    def __getitem__(self, name: str) -> Floats:
        return written(self.kept[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.kept)

    def __len__(self) -> int:
        return len(self.kept)


def kept(covariances: Mapping[str, Floats]) -> Mapping[str, Spread]:
    """Return ``covariances`` in the form in which they are kept."""
    return covariances.kept if isinstance(covariances, Covariances) else covariances


def written(covariance: Spread) -> Floats:
    """Return a covariance as a matrix (n, n)."""
    return covariance.dense() if isinstance(covariance, CompactCovariance) else covariance


def variances_of(covariance: Spread) -> Floats:
    """Return the variances (n,) of a ``covariance``."""
    if isinstance(covariance, CompactCovariance):
        return covariance.variances
    return np.maximum(covariance.diagonal(), 0.0)


def difference_variance(covariance: Spread, first: int | Ints, last: int | Ints) -> Floats:
    """Return the variances (q,) of what rows ``first`` and ``last`` (q,) differ by."""
    if isinstance(covariance, CompactCovariance):
        return covariance.of_differences(first, last)
    both = covariance[first, first] + covariance[last, last]
    return np.asarray(np.maximum(both - 2.0 * covariance[first, last], 0.0))


def mapped(covariance: Spread, to: Floats | csr_array) -> Spread:
    """Return that of ``to`` (m, n) times the values."""
    if isinstance(covariance, CompactCovariance):
        return covariance.mapped(to)
    if isinstance(to, np.ndarray):
        return np.asarray(to @ covariance @ to.T)
    # turned twice: a value that is only carried along keeps its bits
    return np.ascontiguousarray((to @ (to @ covariance).T).T)


def require_allowed(what: str, rows: Floats, own: Floats, every: Floats) -> None:
    """Raise ValueError where covariances ``rows`` (q, n) contradict the variances.

    Those of the rows are ``own`` (q,), ``every`` (n,) are all.
    """
    bound = np.outer(*(np.sqrt(np.maximum(each, 0.0)) for each in (own, every)))
    bound += CONTRADICTS * float(every.max(initial=0.0))
    if np.any(np.abs(rows) > bound):
        raise ValueError(f"{what}: it contradicts its variances")


def plain_covariance(covariance: Spread) -> dict[str, Any]:
    """Return a ``covariance`` for a file, by its field."""
    if isinstance(covariance, CompactCovariance):
        return {COMPACT: covariance.to_dict()}
    return {"covariance": covariance}


def plain_covariances(covariances: Mapping[str, Spread]) -> dict[str, Any]:
    """Return ``covariances`` by component for a file, by their fields."""
    found: dict[str, Any] = {"covariance": {}}
    for name, covariance in covariances.items():
        for field, own in plain_covariance(covariance).items():
            found.setdefault(field, {})[name] = own
    return found


def covariances_from(data: Mapping[str, Any], n: int) -> Covariances:
    """Return those of a file, of ``n`` angles; ValueError where one exceeds its variances."""
    whole = finite_columns(data["covariance"], "covariance", (n, n))
    for name, matrix in whole.items():
        require_allowed(f"covariance.{name}", matrix, matrix.diagonal(), matrix.diagonal())
    compact = dict(data.get(COMPACT, {})).items()
    return Covariances({**whole, **{c: CompactCovariance.from_dict(d, n) for c, d in compact}})


def spread_from(data: Mapping[str, Any], n: int, where: str) -> Spread:
    """Return the covariance of ``n`` values at ``where`` in a file; ValueError for none."""
    if COMPACT in data:
        return CompactCovariance.from_dict(data[COMPACT], n)
    return floats(data["covariance"], f"{where}.covariance")


def _rows(value: Floats, column: Ints, begin: Ints, columns: int) -> csr_array:
    from scipy.sparse import csr_array

    return csr_array((value, column, begin), shape=(len(begin) - 1, columns))


def _packed(numbers: Any, form: str) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers, dtype=form).tobytes()).decode("ascii")


def _unpacked(text: Any, form: str) -> Any:
    try:
        found = np.frombuffer(base64.b64decode(text, validate=True), dtype=form)
    except (TypeError, ValueError, binascii.Error) as error:
        raise ValueError(f"compact covariance: no numbers: {error}") from error
    return found.astype(np.int64 if form == "<i4" else np.float64)
