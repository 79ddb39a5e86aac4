"""Small linear worlds, and the same answers by plain linear algebra of the whole problem."""

from dataclasses import dataclass

import numpy as np

from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.sensitivity import Sensitivity


def places_on_a_ring(e):
    angle = 2 * np.pi * np.arange(e) / e
    return np.column_stack([np.cos(angle), np.sin(angle)])


def lines(groups=4, e=8, own_zero=True):
    """Observations of `groups` points in a plane by e distances each; (n, p) whitened design."""
    unit = places_on_a_ring(e)
    rows = []
    for g in range(groups):
        block = np.zeros((e, 3 * groups))
        block[:, 3 * g : 3 * g + 2] = unit
        block[:, 3 * g + 2 if own_zero else 2] = 1.0
        rows.append(block)
    design = np.concatenate(rows)
    return design[:, np.abs(design).sum(axis=0) > 0]


def outputs(design, groups, own_zero=True):
    """The x of every point, against that of the first: (groups - 1, p)."""
    columns = [0, *[(3 if own_zero else 2) * g + (0 if own_zero or g == 0 else 1) for g in
                    range(1, groups)]]  # fmt: skip
    found = np.zeros((groups - 1, design.shape[1]))
    found[:, columns[0]] = -1.0
    found[np.arange(groups - 1), columns[1:]] = 1.0
    return found


def residuals(design, errors):
    return errors - design @ np.linalg.lstsq(design, errors, rcond=None)[0]


def in_residual_space(design):
    """(n, n - rank) orthonormal columns that the design does not touch."""
    left, values, _ = np.linalg.svd(design)
    rank = int((values > 1e-9 * values[0]).sum())
    return left[:, rank:]


@dataclass(frozen=True, eq=False)
class Dense:
    """A whitened design (n, p), outputs (o, p) and residuals (n,), by the pseudo inverse."""

    design: np.ndarray
    outputs: np.ndarray
    residual: np.ndarray

    @property
    def gain(self):
        return np.linalg.pinv(self.design)

    @property
    def std(self):
        return np.linalg.norm(self.outputs @ self.gain, axis=1)

    def group(self, kind, name, members, rows, unit=None, gathered=None):
        """Rows (e, c) or (e,) of the design as a group."""
        at = rows.reshape(len(members), -1)
        unit = np.ones(at.shape) if unit is None else unit.reshape(at.shape)
        gain = self.gain[:, at.ravel()]
        return Group.of(
            kind, name, members, self.residual[at], unit, self.design[at.ravel()] @ gain,
            lambda: Sensitivity.whole(self.outputs @ gain), gathered,
        )  # fmt: skip
