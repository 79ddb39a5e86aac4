"""What could go wrong while a tracer measures, as errors of its lengths per unit of size.

Each pattern has shape (p, n), m per unit; see :class:`Timing` for when a length was taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats, Ints
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.adjustment import ranges
from rotcal_ros.methods.tracer.solution import TracerSolution

KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of the run after which a knock is tried."""


@dataclass(frozen=True, eq=False)
class Timing:
    """When the lengths were taken: ``share`` (m, n) of the run that had gone, 0 to 1.

    ``arrivals`` (m,): how often the table came to each position.
    """

    share: Floats
    arrivals: Ints


def timing(solution: TracerSolution) -> Timing:
    """Return when the lengths of ``solution`` were taken; see TracerProblem.order."""
    problem, row = solution.problem, solution.grid.row
    first = np.argsort(problem.measuring_order, kind="stable")
    rank = np.empty(len(first))
    rank[first] = np.linspace(0.0, 1.0, len(first))
    at = problem.position[first]
    come = np.append(True, np.diff(at) != 0)
    arrivals = np.bincount(at[come], minlength=len(problem.table_angles))
    return Timing(np.where(row >= 0, rank[row], 0.0), arrivals[solution.positions])


def drifts(solution: TracerSolution, when: Timing) -> Floats:
    """Return the frame of the machine drifting linearly by a metre along x, y, z: (3, m, n)."""
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    return np.asarray(-when.share * unit.transpose(2, 0, 1), dtype=np.float64)


def turning(solution: TracerSolution, when: Timing) -> Floats:
    """Return the frame of the machine turning about the table's axis by a radian: (1, m, n)."""
    motion, fit = solution.motion, solution.fit
    _, unit = ranges(fit.standing, fit.targets)
    arms = cross_matrix(motion.plane.normal[None])[0] @ (fit.targets - motion.centre).T
    return np.asarray(-when.share * np.einsum("jia,ai->ji", unit, arms), dtype=np.float64)[None]


def knocks(solution: TracerSolution, when: Timing) -> Floats:
    """Return the tracer shifted on the table by a metre: out, along, up; (9, m, n)."""
    motion = solution.motion
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    basis, station = motion.plane.basis(), solution.grid.station
    out = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    along = np.column_stack([-out[:, 1], out[:, 0]])
    up = np.broadcast_to(motion.plane.normal, (len(out), 3))
    shifts = np.stack([out @ basis, along @ basis, up])
    felt = np.einsum("sja,jia->sji", shifts[:, station], unit)
    later: list[Bools] = [when.share >= share for share in KNOCKED_AT]
    return np.concatenate([felt * late for late in later])


def scale(solution: TracerSolution) -> Floats:
    """Return lengths that are too long by their own size: (1, m, n)."""
    return ranges(solution.fit.standing, solution.fit.targets)[0][None]


def refraction(solution: TracerSolution) -> Floats:
    """Return an index of the air that grows by one per metre of height: (1, m, n)."""
    fit = solution.fit
    distance, _ = ranges(fit.standing, fit.targets)
    height = 0.5 * (fit.standing[:, None, 2] + fit.targets[:, 2])
    return np.asarray(distance * (height - height.mean()))[None]
